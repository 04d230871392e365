"""Kill -9 at the end of missions: after the next start everything that a mission leaves is on disk.

`PANOEXEC_END_KILLS` sets how many missions are killed (default 3).
"""

from __future__ import annotations

import asyncio
import csv
import os
import random
import signal
import sys
from collections import Counter
from pathlib import Path

from panoexec.daemon.leftovers import restore_leftovers
from panoexec.store.catalogue import catalogue, glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.manifest import read_manifest
from panoexec.store.session import open_mission
from tests.repository import ROOT
from tests.system.ending_mission import fly, the_missions
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import ListSink, a_world

KILLS = int(os.environ.get("PANOEXEC_END_KILLS", "3"))
LEFT = ("manifest.json", "shots.csv", "panorama.pto", "papywizard.xml", "panorama.xmp", "report.html", "outputs.json")
SHOTS = 4


async def _killed(storage: Path, rng: random.Random) -> None:
    """Fly a mission in a process that is killed between its last shot and the last byte of its report, or later."""
    event, most_s = rng.choice([("mission_finishing", 0.03), ("mission_finished", 0.03), ("mission_finished", 0.3)])
    arguments = [str(storage), event, str(rng.uniform(0.0, most_s))]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tests.system.ending_mission", *arguments, cwd=ROOT, stderr=asyncio.subprocess.PIPE
    )
    _, errors = await process.communicate()
    assert process.returncode == -signal.SIGKILL, errors.decode()


def _started_again(storage: Path) -> str:
    """The next start of a daemon; returns what the killed process had left."""

    async def main() -> str:
        async with a_world() as world:
            missions = the_missions(storage, world, ListSink())
            (stored,) = catalogue(storage)
            directory = stored.directory
            assert stored.glance is not None, stored.problem
            lacking = [name for name in LEFT if not (directory.path / name).exists()]
            found = f"{stored.glance.state}, {len(lacking)} of {len(LEFT)} files lacking"
            resumable = await missions.find_interrupted()
            assert resumable is (stored.glance.state.value != "complete")
            if resumable:  # its end was not on disk
                await fly(missions, await open_mission(directory), world)
            await restore_leftovers(lambda: storage, missions)
            return found

    return run_virtual(main())


def _assert_complete(directory: MissionDirectory) -> None:
    seen = glance(directory.journal)
    manifest = read_manifest(directory.manifest)
    assert manifest["state"] == seen.state.value == "complete"
    assert manifest["journal"] == {"events": seen.events}
    assert manifest["counts"]["shots_done"] == SHOTS
    assert [name for name in LEFT if not (directory.path / name).exists()] == []
    with directory.path.joinpath("shots.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == SHOTS
    assert directory.report.read_text(encoding="utf-8").rstrip().endswith("</html>")
    assert [path.name for path in directory.path.iterdir() if path.name.startswith(".")] == []


def test_what_a_killed_process_left_is_written_at_the_next_start(tmp_path: Path) -> None:
    rng = random.Random(13)
    found: Counter[str] = Counter()
    for number in range(KILLS):
        storage = tmp_path / str(number)
        asyncio.run(_killed(storage, rng))
        found[_started_again(storage)] += 1
        (stored,) = catalogue(storage)
        _assert_complete(stored.directory)
    for left, count in sorted(found.items()):
        print(count, left)
