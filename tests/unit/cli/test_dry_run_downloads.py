"""A dry-run, which may fly a vehicle on a bench, lets MAVSDK ask no host for anything."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")
pytest.importorskip("PIL")

from panoexec.cli import dry_run
from panoexec.cli.app import run
from panoexec.errors import PanoexecError


def test_a_dry_run_asks_no_host_for_anything(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[str | None] = []

    async def flown(*_: Any, **__: Any) -> None:
        seen.append(os.environ.get("http_proxy"))
        raise PanoexecError("far enough")

    monkeypatch.setattr(dry_run, "run_dry_run", flown)
    before = os.environ.get("http_proxy")
    assert run(["dry-run", "--sitl-connect", "udpin://127.0.0.1:9", "--output", str(tmp_path)]) != 0
    assert seen == ["http://127.0.0.1:9"]
    assert os.environ.get("http_proxy") == before
