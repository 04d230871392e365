"""What is told of an overlap that is too small: one threshold, and figures that add up."""

from __future__ import annotations

import re

import pytest

from panoexec.cli.app import run


@pytest.mark.parametrize("required", ["0.15", "0.25"])
def test_the_figures_of_an_overlap_that_is_too_small_add_up(required: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["verify", "scenario-2-proposed", "--overlap", required]) == 1
    out = " ".join(capsys.readouterr().out.split())
    told = re.findall(r"overlap ([\d.]+)%.*?([\d.]+)% below the required ([\d.]+)%", out)
    assert told
    for value, missing, threshold in told:
        assert float(threshold) == pytest.approx(100 * float(required))
        assert float(value) + float(missing) == pytest.approx(float(threshold), abs=0.011)
