"""What valid plan requests cost at most: `PANOEXEC_HOSTILE=500` for a whole campaign, seeded by its number."""

from __future__ import annotations

import os
import subprocess
import sys

MOST_MB = 300


def test_requests_made_to_cost_memory_stay_below_the_limit() -> None:
    count = int(os.environ.get("PANOEXEC_HOSTILE", "0"))
    # the short campaign is of kinds that are refused or judged within seconds
    arguments = [str(count), "1"] if count else ["7", "2", "large_tolerance"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.system.hostile_plans", *arguments], capture_output=True, text=True, check=True
    )
    lines = [line.split() for line in done.stdout.partition("largest:")[0].splitlines()]
    assert lines
    peaks = {f"{number} {kind}": float(peak_mb) for number, kind, peak_mb, *_ in lines}
    assert {name: peak for name, peak in peaks.items() if peak > MOST_MB} == {}
