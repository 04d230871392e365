"""What the daemon finds on disk at its start, and whether it may go on with it by itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from panoexec.clock import SystemClock
from panoexec.daemon.missions import Missions
from panoexec.inputs.config import Config
from panoexec.inputs.service_sections import StorageSection
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store.directory import mission_directories
from panoexec.store.session import create_mission
from tests.unit.fakes.world import ListSink, a_plan, some_settings

S = MissionState


async def _left(storage: Path, *events: ev.Event) -> None:
    """A mission of which a process left these events."""
    stored = await create_mission(storage, plan=a_plan(), settings=some_settings(), now_utc_s=1.7e9)
    await stored.journal.append(events)
    await stored.journal.close()


def _missions(storage: Path) -> Missions:
    config = Config(storage=StorageSection(path=storage))
    return Missions(config=lambda: config, clock=SystemClock(), sink=ListSink(), changed=lambda: None)


def _head(seq: int, state: MissionState = S.CAPTURING) -> dict[str, object]:
    return {"mission_id": "m1", "seq": seq, "time_utc_s": 1.7e9, "state": state}


STARTED = ev.MissionStarted(**_head(1, S.PREFLIGHT), shots_total=4)  # type: ignore[arg-type]


@pytest.mark.parametrize(("commands", "by_itself"), [([], True), (["pause"], False), (["pause", "resume"], True)])
async def test_a_mission_that_was_to_hold_does_not_go_on_by_itself(
    tmp_path: Path, commands: list[str], by_itself: bool
) -> None:
    asked = [
        ev.CommandReceived(**_head(seq, S.PREFLIGHT), command=name)  # type: ignore[arg-type]
        for seq, name in enumerate(commands, start=2)
    ]
    await _left(tmp_path, STARTED, *asked)
    missions = _missions(tmp_path)
    assert await missions.find_interrupted() is by_itself
    assert missions.offer is not None


async def test_one_that_a_service_manager_stopped_in_its_pause_holds_too(tmp_path: Path) -> None:
    await _left(
        tmp_path,
        STARTED,
        ev.CommandReceived(**_head(2, S.PREFLIGHT), command="pause"),  # type: ignore[arg-type]
        ev.MissionPaused(**_head(3, S.PAUSED), code="command", reason="x"),  # type: ignore[arg-type]
        ev.CommandReceived(**_head(4, S.PAUSED), command="interrupt"),  # type: ignore[arg-type]
        ev.MissionPaused(**_head(5, S.PAUSED), code="interrupted", reason="x"),  # type: ignore[arg-type]
    )
    assert not await _missions(tmp_path).find_interrupted()


async def test_a_damaged_one_is_no_reason_not_to_start(tmp_path: Path) -> None:
    await _left(tmp_path, STARTED)
    journal = mission_directories(tmp_path)[0].journal
    data = bytearray(journal.read_bytes())
    data[data.index(b"panoexec.plan/1")] = 0xFF
    journal.write_bytes(data)
    missions = _missions(tmp_path)
    assert not await missions.find_interrupted()
    assert missions.offer is None
    assert journal.read_bytes() == data
