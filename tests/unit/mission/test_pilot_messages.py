"""What the pilot hears of a mission."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from panoexec.devices import Severity
from panoexec.errors import MissionError
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.mission.pilot_messages import (
    FLUSH_TIMEOUT_S,
    PAUSE_TEXTS,
    PilotMessage,
    PilotMessenger,
    pilot_message_for,
)
from panoexec.store.session import Devices, MissionSession, create_mission, open_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_plan, a_world, some_settings

Script = Callable[[World, MissionSession], Awaitable[None]]
LINE = 50


async def _fly(world: World, storage: Path, script: Script | None = None) -> list[tuple[Severity, str]]:
    stored = await create_mission(
        storage, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time(), extra={}
    )
    devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
    opened = MissionSession.opened(stored, devices=devices, clock=world.clock, sink=world.sink, vehicle={})
    async with opened as session, asyncio.TaskGroup() as group:
        if script is not None:
            group.create_task(_run(script, world, session), name="script")
        await session.run()
    return world.vehicle.said


async def _run(script: Script, world: World, session: MissionSession) -> None:
    await script(world, session)


def heard(storage: Path, script: Script | None = None, prepare: Callable[[World], None] = lambda _: None) -> list[str]:
    async def main() -> list[str]:
        async with a_world(settings=some_settings()) as world:
            prepare(world)
            said = await _fly(world, storage, script)
            return [f"{severity.name} {text}" for severity, text in said]

    return run_virtual(main())


def test_a_mission_without_trouble(tmp_path: Path) -> None:
    assert heard(tmp_path) == [
        "INFO Pano: 4 shots, preflight checks",
        "NOTICE Pano: shooting, hold position",
        "NOTICE Pano: complete, 4/4, gimbal released",
    ]


def test_a_pause_an_end_of_it_and_an_abort(tmp_path: Path) -> None:
    async def script(world: World, session: MissionSession) -> None:
        await world.clock.sleep(3.0)
        session.mission.commands.pause("coffee")
        await world.clock.sleep(3.0)
        session.mission.commands.resume()
        await world.clock.sleep(0.5)
        session.mission.commands.abort()

    assert heard(tmp_path, script)[2:] == [
        "NOTICE Pano: paused: by command",
        "NOTICE Pano: continues at 1/4",
        "WARNING Pano: aborted at 2/4, gimbal released",
    ]


def test_guards_and_a_reboot(tmp_path: Path) -> None:
    async def script(world: World, session: MissionSession) -> None:
        await world.clock.sleep(3.0)
        world.vehicle.change(battery_frac=0.2, boot_count=1)
        while session.mission.record.state is not MissionState.PAUSED:
            await world.clock.sleep(0.05)
        world.vehicle.change(battery_frac=0.9)
        await world.clock.sleep(0.5)
        session.mission.commands.resume()

    assert heard(tmp_path, script)[2:5] == [
        "WARNING Pano: autopilot rebooted",
        "WARNING Pano: paused: battery low: land, swap, resume",
        "NOTICE Pano: continues at 1/4",
    ]


def test_what_is_wrong_before_the_start(tmp_path: Path) -> None:
    said = heard(tmp_path, prepare=lambda w: w.vehicle.change(in_air=False))
    assert said[1] == "ERROR Pano: not started: the vehicle is not in the air: take off and hover"


def test_a_stop_of_the_process_and_what_the_next_one_says(tmp_path: Path) -> None:
    async def main() -> list[str]:
        async with a_world() as world:

            async def stop(world: World, session: MissionSession) -> None:
                await world.clock.sleep(3.0)
                session.mission.commands.interrupt()
                stored.append(session.stored.directory)

            stored: list[object] = []
            await _fly(world, tmp_path, stop)
            again = await open_mission(stored[0])  # type: ignore[arg-type]
            devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
            opened = MissionSession.opened(again, devices=devices, clock=world.clock, sink=world.sink, vehicle={})
            async with opened as session:
                await session.run()
            return [text for _, text in world.vehicle.said]

    assert run_virtual(main())[2:4] == [
        "Pano: stopped at 1/4, can be resumed",
        "Pano: resumed at 1/4, preflight checks",
    ]


def test_an_error_of_ours_is_not_kept_from_the_pilot(tmp_path: Path) -> None:
    async def main() -> list[tuple[Severity, str]]:
        async with a_world() as world:

            async def delete(world: World, session: MissionSession) -> None:
                await world.clock.sleep(3.0)
                session.stored.directory.journal.unlink()

            with pytest.RaisesGroup(MissionError):
                await _fly(world, tmp_path, delete)
            return world.vehicle.said

    assert run_virtual(main())[-1] == (Severity.ERROR, "Pano: stopped by an error, gimbal released")


def test_a_link_that_takes_no_words_keeps_no_mission_waiting(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            world.vehicle.deaf = True
            began = world.clock.monotonic()
            await _fly(world, tmp_path)
            assert world.journal.events == []
            finished = world.sink.events[-1].time_utc_s - 1_700_000_000.0
            assert world.clock.monotonic() - finished <= FLUSH_TIMEOUT_S + 0.01
            assert finished > began

    run_virtual(main())


def test_the_oldest_words_are_dropped_when_too_many_wait() -> None:
    async def main() -> None:
        async with a_world() as world:
            messenger = PilotMessenger(vehicle=world.vehicle, record=world.record_of_journal())
            for number in range(50):
                messenger.send(PilotMessage(str(number), Severity.INFO))
            await messenger.flush()
            assert [text for _, text in world.vehicle.said] == [f"Pano: {number}" for number in range(30, 50)]

    run_virtual(main())


def test_every_guard_has_words_that_fit_on_a_line() -> None:
    import ast  # noqa: PLC0415
    import inspect  # noqa: PLC0415

    from panoexec.mission import guards  # noqa: PLC0415
    from panoexec.mission.pointing.nose_hold import HEADING_CODE  # noqa: PLC0415
    from panoexec.mission.systematic_failure import HOLD_CODES  # noqa: PLC0415

    tree = ast.parse(inspect.getsource(guards))
    codes = {
        keyword.value.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding"
        for keyword in node.keywords
        if keyword.arg == "code" and isinstance(keyword.value, ast.Constant)
    }
    assert len(codes) >= 8
    assert codes | HOLD_CODES | {"command", HEADING_CODE} == set(PAUSE_TEXTS)
    assert all(len(f"Pano: paused: {words}") <= LINE for words in PAUSE_TEXTS.values())


def test_a_message_on_its_way_when_the_mission_ends_is_said_once() -> None:
    async def main() -> list[str]:
        async with a_world() as world:
            said, began = [], asyncio.Event()

            async def say(text: str, severity: Severity = Severity.NOTICE) -> None:
                began.set()
                await asyncio.sleep(0.2)
                said.append(f"{severity.name} {text}")

            world.vehicle.say = say  # type: ignore[method-assign]
            messenger = PilotMessenger(vehicle=world.vehicle, record=world.mission().record)
            running = asyncio.create_task(messenger.run())
            messenger.send(PilotMessage("the last line", Severity.NOTICE))
            await began.wait()
            running.cancel()
            await messenger.flush()
            await asyncio.sleep(1.0)
            return said

    assert run_virtual(main()) == ["NOTICE Pano: the last line"]


def test_an_autopilot_that_takes_the_gimbal_for_its_new_mode_is_not_another_station(tmp_path: Path) -> None:
    async def script(world: World, session: MissionSession) -> None:
        await world.clock.sleep(3.0)
        world.gimbal.other, world.gimbal.in_control = (1, 1), False
        await world.clock.sleep(0.9)  # until the next heartbeat
        world.vehicle.change(mode="RETURN_TO_LAUNCH")
        await world.clock.sleep(3.0)
        session.mission.commands.abort()

    assert heard(tmp_path, script)[2:] == [
        "WARNING Pano: paused: pilot has control, gimbal released",
        "WARNING Pano: aborted at 1/4, gimbal released",
    ]


def test_an_autopilot_that_keeps_the_gimbal_in_the_same_mode_is_told_of(tmp_path: Path) -> None:
    async def script(world: World, session: MissionSession) -> None:
        await world.clock.sleep(3.0)
        world.gimbal.other, world.gimbal.in_control = (1, 1), False
        await world.clock.sleep(3.0)
        session.mission.commands.abort()

    assert heard(tmp_path, script)[2:3] == ["WARNING Pano: paused: another station has the gimbal"]


def ended(state: MissionState, *, missing: tuple[int, ...] = (), bad: bool = False, **content: Any) -> str:
    """The last message of a mission with this record."""
    record = MissionRecord(mission_id="m", shots=a_plan().shots)
    record.content = ev.ContentJudged(**content) if content else None
    if bad:
        record.bad_photos = lambda: {2: "blurred", 3: "untied"}  # type: ignore[method-assign]
    event = ev.MissionFinished(reason="", accepted=4 - len(missing), missing=missing, state=state)
    message = pilot_message_for(event, record)
    assert message is not None
    assert len(f"Pano: {message.text}") <= LINE
    return message.text


def test_the_last_message_tells_which_part_is_lacking() -> None:
    complete, incomplete = MissionState.COMPLETE, MissionState.INCOMPLETE
    assert ended(complete) == "complete, 0/4, gimbal released"
    assert ended(complete, groups=1) == "complete, 0/4, geometry and content good"
    assert ended(complete, groups=1, geometry_only=(1, 3)) == "complete, 0/4, 2 by geometry only"
    assert ended(complete, groups=2) == "complete, 0/4, tied in 2 groups"
    assert ended(complete, groups=1, unchecked=(1,)) == "complete, 0/4, content of 1 unchecked"
    assert ended(incomplete, missing=(1, 2)) == "ended, 2 of 4 missing"
    assert ended(incomplete, missing=(1,), bad=True) == "ended, 1 of 4 missing, content of 2 bad"
    assert ended(incomplete, bad=True) == "ended, content of 2 bad"
    assert ended(incomplete, groups=1) == "ended, geometry has a hole"
