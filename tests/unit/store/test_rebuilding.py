"""The manifest against the journal: damage is noticed, and what the journal knows is written again."""

from __future__ import annotations

import json
import os
import random
import shutil
from pathlib import Path

import pytest

from panoexec.errors import InputFileError
from panoexec.mission.log import events as ev
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.catalogue import glance
from panoexec.store.directory import MissionDirectory
from panoexec.store.journal import SqliteJournal
from panoexec.store.manifest import manifest_events, read_manifest
from panoexec.store.rebuilding import LostEventsError, current_manifest, restore_manifest
from panoexec.store.session import Devices, MissionSession, create_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import a_world

FLIPS = int(os.environ.get("PANOEXEC_FLIPS", "240"))


@pytest.fixture(scope="module", name="flown")
def a_flown_mission(tmp_path_factory: pytest.TempPathFactory) -> MissionDirectory:
    """A complete mission, with manifest and journal."""
    storage = tmp_path_factory.mktemp("flown")

    async def fly() -> MissionDirectory:
        async with a_world() as world:
            devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
            stored = await create_mission(
                storage, plan=world.plan, settings=world.settings, now_utc_s=world.clock.time(),
                extra={"vehicle": {"id": "v1"}},
            )  # fmt: skip
            opened = MissionSession.opened(
                stored, devices=devices, clock=world.clock, sink=world.sink, vehicle={"id": "v1"}
            )
            async with opened as session:
                await session.run()
            return stored.directory

    return run_virtual(fly())


@pytest.fixture
def mission(flown: MissionDirectory, tmp_path: Path) -> MissionDirectory:
    return MissionDirectory(Path(shutil.copytree(flown.path, tmp_path / flown.mission_id)))


def _without_times(document: dict[str, object]) -> dict[str, object]:
    times = dict(document["times"])  # type: ignore[call-overload]
    # the certificate of these fakes is a fake too, the battery is in no event
    return document | {"times": times | {"written": ""}, "digest": "", "certificate": None, "battery": []}


def test_it_says_up_to_which_event_it_tells(mission: MissionDirectory) -> None:
    document = read_manifest(mission.manifest)
    assert manifest_events(document) == glance(mission.journal).events > 10
    assert not restore_manifest(mission)
    assert current_manifest(mission) == document


def test_a_flipped_bit_is_harmless_or_told(mission: MissionDirectory) -> None:
    whole = mission.manifest.read_bytes()
    document = json.loads(whole)
    rng = random.Random(3)
    told = 0
    for _ in range(FLIPS):
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        mission.manifest.write_bytes(data)
        try:
            assert read_manifest(mission.manifest) == document
        except InputFileError:
            told += 1
    assert told > FLIPS // 2


def test_another_layout_of_the_same_content_is_no_damage(mission: MissionDirectory) -> None:
    document = read_manifest(mission.manifest)
    mission.manifest.write_text(json.dumps(document, indent=4, ensure_ascii=False), encoding="utf-8")
    assert read_manifest(mission.manifest) == document
    document["state"] = "incomplete"
    mission.manifest.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputFileError, match="changed since it was written"):
        read_manifest(mission.manifest)


@pytest.mark.parametrize("damage", ["missing", "damaged", "older"])
def test_what_the_journal_knows_is_written_again(mission: MissionDirectory, damage: str) -> None:
    recorded = read_manifest(mission.manifest)
    if damage == "missing":
        mission.manifest.unlink()
    elif damage == "damaged":
        mission.manifest.write_bytes(mission.manifest.read_bytes().replace(b"complete", b"somplete", 1))
    else:
        _add_event(mission)
    current = current_manifest(mission)
    assert restore_manifest(mission)
    restored = read_manifest(mission.manifest)
    if damage == "older":
        assert restored["warnings"][-1:] == ["y"]
        restored = restored | {"warnings": recorded["warnings"], "journal": recorded["journal"]}
    assert _without_times(restored) == _without_times(recorded)
    assert current["counts"] == recorded["counts"]
    assert not restore_manifest(mission)


def _add_event(mission: MissionDirectory) -> None:
    async def append() -> None:
        async with await SqliteJournal.open(mission.journal) as journal:
            events = await journal.events()
            last = events[-1]
            await journal.append(
                [ev.Warned(mission_id=last.mission_id, seq=last.seq + 1, state=last.state, code="x", text="y")]
            )

    run_virtual(append())


def test_a_journal_that_lost_its_end_is_told_by_the_manifest(mission: MissionDirectory) -> None:
    """The write-ahead log of a killed process was deleted."""
    before = shutil.copy(mission.journal, mission.path / "before.sqlite")
    _add_event(mission)
    restore_manifest(mission)
    shutil.move(before, mission.journal)
    text = mission.manifest.read_bytes()
    with pytest.raises(LostEventsError, match="the journal lost its end"):
        restore_outputs(mission)
    assert mission.manifest.read_bytes() == text


def test_outputs_are_written_again_where_one_is_missing_or_older(mission: MissionDirectory) -> None:
    assert restore_outputs(mission)
    assert not restore_outputs(mission)
    names = json.loads(mission.outputs.read_text())["files"]
    assert {"report.html", "panorama.pto", "shots.csv", "papywizard.xml", "panorama.xmp"} == set(names)
    for name in ("manifest.json", "outputs.json", *names):
        (mission.path / name).unlink()
        assert restore_outputs(mission), name
        assert (mission.path / name).exists()
    _add_event(mission)
    assert restore_outputs(mission)
    assert manifest_events(read_manifest(mission.manifest)) == glance(mission.journal).events
    left = mission.path / ".report-abcd1234.html"
    left.touch()
    mission.report.unlink()
    assert restore_outputs(mission)
    assert not left.exists()


def test_a_mission_of_an_earlier_version_is_left_alone_if_nothing_is_missing(tmp_path: Path) -> None:
    recorded = Path(__file__).parents[2] / "data" / "recorded"
    mission = MissionDirectory(Path(shutil.copytree(recorded, tmp_path / "recorded")))
    for name in ("shots.csv", "report.html"):
        (mission.path / name).touch()
    before = {path.name: path.read_bytes() for path in mission.path.iterdir()}
    assert not restore_outputs(mission)
    assert {path.name: path.read_bytes() for path in mission.path.iterdir()} == before
    # one that an earlier version left behind by its kill: the state has not come that far
    manifest = json.loads(mission.manifest.read_text())
    mission.manifest.write_text(json.dumps(manifest | {"state": "capturing", "certificate": None}))
    assert restore_outputs(mission)
    restored = read_manifest(mission.manifest)
    assert (restored["state"], restored["counts"]) == ("complete", manifest["counts"])
    assert restored["certificate"]["certified"]
    assert restored["vehicle"] == manifest["vehicle"]
