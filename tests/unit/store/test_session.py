"""Missions with a directory: what is on disk, what can be resumed, what is refused."""

from __future__ import annotations

import asyncio
import json
import shutil
import sqlite3
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from panoexec.errors import MissionError
from panoexec.inputs.plan_file import read_plan_file
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.store.directory import MissionDirectory, existing_mission_directory, mission_directories
from panoexec.store.journal import JournalFileError
from panoexec.store.manifest import read_manifest
from panoexec.store.session import (
    Devices,
    MissionSession,
    NotResumableError,
    StoredMission,
    create_mission,
    open_mission,
)
from tests.unit.fakes.flying import until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

S = MissionState


async def _fly(
    world: World, stored: StoredMission, beside: Callable[[MissionSession], Awaitable[None]] | None = None
) -> MissionRecord:
    devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
    opened = MissionSession.opened(stored, devices=devices, clock=world.clock, sink=world.sink, vehicle={"id": "v1"})
    async with opened as session, asyncio.TaskGroup() as group:
        if beside is not None:
            group.create_task(_coroutine(beside(session)), name="beside")
        return await session.run()


async def _coroutine(work: Awaitable[None]) -> None:
    await work


async def _new(world: World, storage: Path) -> StoredMission:
    return await create_mission(
        storage, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time(), extra={"mine": 1}
    )


async def _interrupted(world: World, storage: Path) -> MissionDirectory:
    """A mission that was stopped after two shots."""
    stored = await _new(world, storage)

    async def stop(session: MissionSession) -> None:
        await until_event(world, ev.ShotAccepted, 2)
        session.mission.commands.interrupt()

    assert (await _fly(world, stored, stop)).state is S.PAUSED
    return stored.directory


def test_a_mission_leaves_plan_journal_and_manifest(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            stored = await _new(world, tmp_path)
            record = await _fly(world, stored)
            assert record.state is S.COMPLETE
            directory = stored.directory
            assert mission_directories(tmp_path) == [directory]
            assert read_plan_file(directory.plan).shots == world.plan.shots
            manifest = read_manifest(directory.manifest)
            assert (manifest["state"], manifest["mission_id"]) == ("complete", directory.mission_id)
            assert {path.name for path in directory.path.iterdir()} == {"plan.json", "manifest.json", "journal.sqlite"}

    run_virtual(main())


def test_an_interrupted_mission_goes_on_with_its_own_plan_and_settings(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            directory = await _interrupted(world, tmp_path)
            assert read_manifest(directory.manifest)["state"] == "paused"
            stored = await open_mission(existing_mission_directory(directory.path))
            assert (stored.plan.shots, stored.settings, stored.extra) == (world.plan.shots, world.settings, {"mine": 1})
            record = await _fly(world, stored)
            assert record.state is S.COMPLETE
            assert record.restarts == 1
            assert len(world.camera.photos) == 4
            seqs = [event.seq for event in world.sink.events]
            assert seqs == list(range(1, len(seqs) + 1))

    run_virtual(main())


def test_a_mission_that_is_over_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            stored = await _new(world, tmp_path)
            await _fly(world, stored)
            before = {path.name: path.read_bytes() for path in stored.directory.path.iterdir()}
            with pytest.raises(NotResumableError, match=r"the mission is complete .* cannot be resumed"):
                await open_mission(stored.directory)
            assert {path.name: path.read_bytes() for path in stored.directory.path.iterdir()} == before

    run_virtual(main())


def _change(statement: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        connection = sqlite3.connect(path)
        with connection:
            connection.execute(statement)
        connection.close()

    return change


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (_change("DELETE FROM head WHERE key = 'settings'"), "damaged"),
        (_change("UPDATE head SET value = '{' WHERE key = 'settings'"), "damaged"),
        (_change("UPDATE head SET value = '{\"attempts\": 3}' WHERE key = 'settings'"), "damaged"),
        (_change("DELETE FROM events WHERE seq = 4"), "damaged"),
        (_change("UPDATE events SET json = replace(json, '\"shot\":0', '\"shot\":77')"), "damaged"),
        (_change("PRAGMA user_version = 7"), r"newer panoexec .*update panoexec to resume it"),
        (lambda path: path.write_bytes(path.read_bytes()[:6000]), "damaged"),
        (lambda path: path.write_bytes(b""), "not an SQLite file"),
        (lambda path: path.unlink(), "there is no journal"),
    ],
)
def test_a_journal_that_cannot_be_gone_on_with_is_refused(
    tmp_path: Path, damage: Callable[[Path], None], text: str
) -> None:
    async def main() -> None:
        async with a_world() as world:
            directory = await _interrupted(world, tmp_path)
            damage(directory.journal)
            before = {path.name: path.read_bytes() for path in directory.path.iterdir()}
            with pytest.raises(JournalFileError, match=text):
                await open_mission(directory)
            assert {path.name: path.read_bytes() for path in directory.path.iterdir()} == before

    run_virtual(main())


def test_a_directory_deleted_under_a_running_mission_ends_it_with_the_gimbal_released(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            stored = await _new(world, tmp_path)

            async def delete(session: MissionSession) -> None:
                await until_event(world, ev.ShotAccepted, 1)
                shutil.rmtree(session.stored.directory.path)

            with pytest.RaisesGroup(pytest.RaisesExc(MissionError, match="deleted while the mission was running")):
                await _fly(world, stored, delete)
            assert not world.gimbal.in_control
            assert not stored.directory.path.exists()

    run_virtual(main())


def test_readers_never_see_half_a_manifest(tmp_path: Path) -> None:
    async def main() -> None:
        async with a_world() as world:
            stored = await _new(world, tmp_path)
            states = []

            async def look(session: MissionSession) -> None:
                path = session.stored.directory.manifest
                while not session.mission.record.ended:
                    if path.exists():
                        states.append(json.loads(path.read_text(encoding="utf-8"))["state"])
                    await world.clock.sleep(0.2)

            await _fly(world, stored, look)
            assert set(states) >= {"preflight", "capturing"}
            leftovers = [path.name for path in stored.directory.path.iterdir() if path.name.startswith(".")]
            assert leftovers == []

    run_virtual(main())
