"""The end of a dry-run, as a person reads it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink")

from panoexec.cli.dry_run_view import show_summary
from panoexec.dryrun.run import DryRunSummary


def _summary(**changes: Any) -> DryRunSummary:
    fields: dict[str, Any] = {
        "mission_id": "m",
        "directory": Path("m"),
        "state": "aborted",
        "reason": "aborted by command",
        "shots": 13,
        "accepted": 3,
        "attempts": 4,
        "retakes": 1,
        "missing": (3,),
        "rejected": {"crash": 1},
        "worst": None,
        "evidence": {},
        "photos": 3,
        "duration_s": 12.0,
        "limit_s": 10.0,
        "trigger_delay_s": 0.01,
        "certificate": None,
    }
    return DryRunSummary(**fields | changes)


def test_the_time_is_told_beside_the_limit(capsys: pytest.CaptureFixture[str]) -> None:
    show_summary(_summary())
    assert "12.0 s; physical limit 10.0 s, ratio 1.20" in capsys.readouterr().out


def test_a_mission_that_was_over_before_it_began_to_shoot_has_no_time(capsys: pytest.CaptureFixture[str]) -> None:
    show_summary(_summary(duration_s=math.nan, limit_s=0.0))
    text = capsys.readouterr().out
    assert "aborted: aborted by command" in text
    assert "nan" not in text
