"""What errors say about parts that are not installed."""

from __future__ import annotations

import pytest

from panoexec import errors


def test_an_extra_is_installed_by_pip() -> None:
    assert errors.to_install("sim") == "pip install '.[sim]' in a clone, with the pip of its virtual environment"


def test_the_package_of_a_vehicle_does_not_send_people_to_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(errors, "__file__", "/usr/lib/panoexec/panoexec/errors.py")
    assert "pip" not in errors.to_install("report")
    assert "clone" in errors.to_install("report")
