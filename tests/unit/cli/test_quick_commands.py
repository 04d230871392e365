"""Commands that only talk to a broker start fast: they load neither planner, mission nor what draws.

Measured as the processor time of `panoexec send --help`, at most 0.4 s; a test of that would depend on the machine.
"""

from __future__ import annotations

import subprocess
import sys

HEAVY = (
    "numpy",
    "panoexec.planning.model",
    "panoexec.planning.search.planner",
    "panoexec.mission",
    "rich.traceback",
    "mavsdk",
    "aiohttp",
)


def test_they_load_only_what_they_need() -> None:
    program = "import sys, panoexec.cli.operate, panoexec.cli.send, panoexec.cli.watch; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert [name for name in HEAVY if name in done.stdout.split()] == []
