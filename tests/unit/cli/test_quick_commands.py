"""Commands that only talk to a broker start fast: they load neither planner, mission nor what draws.

What costs time is what is loaded; `make bench ARGS=commands` measures the processor time, of which a test would depend
on the machine.
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


MAP = """
import sys
from panoexec.cli.watch_view import Watched, mission_view

one = Watched()
camera = {"hfov_deg": 60.0, "vfov_deg": 40.0}
one.hear("plan", {"camera": camera, "shots": [{"index": 0, "pitch_deg": 0.0, "yaw_deg": 0.0}]})
one.hear("state", {"state": "capturing", "shots_total": 1, "shots": "c1"})
mission_view("drone", one, room=(80, 24))
assert one.sphere is not None
print(*sys.modules)
"""


def loaded(program: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return done.stdout.split()


def test_they_load_only_what_they_need() -> None:
    names = loaded("import sys, panoexec.cli.operate, panoexec.cli.send, panoexec.cli.watch; print(*sys.modules)")
    assert [name for name in HEAVY if name in names] == []


def test_the_map_of_watch_loads_no_planner_and_no_numpy() -> None:
    names = loaded(MAP)
    heavy = ("numpy", "pydantic", "panoexec.planning", "panoexec.mission.log.events", "panoexec.inputs.plan_file")
    assert [name for name in heavy if name in names] == []
