"""Files are brought newest first, tried again, given up where that is final, and added after landing."""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.errors import PhotoFileError
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from panoexec.store import photo_collector
from panoexec.store.journal import JournalFileError, load_journal
from panoexec.store.landed_mission import LandedMission, record_of
from panoexec.store.manifest import read_manifest
from panoexec.store.photo_collector import LocalFiles, PhotoCollector, wanted_files
from panoexec.store.rebuilding import restore_manifest
from panoexec.store.session import Devices, MissionSession, create_mission
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import a_world
from tests.unit.store.test_photo_store import a_jpeg


class FakeFetcher:
    """Brings small JPEGs; `troubles` come first."""

    source = "http"

    def __init__(self, *troubles: PhotoFileError | bytes) -> None:
        self.asked: list[str] = []
        self.troubles = list(troubles)

    def takes(self, url: str) -> bool:
        return url.startswith("IMG_")

    async def fetch(self, url: str, part: Path) -> Path:
        self.asked.append(url)
        trouble = self.troubles.pop(0) if self.troubles else b""
        if isinstance(trouble, PhotoFileError):
            raise trouble
        part.write_bytes(trouble or a_jpeg(40 * int(url[4:8])))  # noqa: ASYNC240
        return part


async def _fly(storage: Path, fetcher: FakeFetcher | None = None) -> MissionSession:
    async with a_world() as world:
        stored = await create_mission(storage, plan=world.plan, settings=world.settings, now_utc_s=0.0)
        devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
        opened = MissionSession.opened(
            stored,
            devices=devices,
            clock=world.clock,
            sink=world.sink,
            vehicle={},
            fetchers=() if fetcher is None else (fetcher,),
        )
        async with opened as session:
            assert (await session.run()).state is MissionState.COMPLETE
        return session


def _landed(storage: Path) -> LandedMission:
    session = run_virtual(_fly(storage))
    return LandedMission.read(session.stored.directory)


def _collector(landed: LandedMission, *fetchers: FakeFetcher | LocalFiles) -> PhotoCollector:
    folder = landed.directory.path
    return PhotoCollector(folder, record=landed.record, store=landed.photos, fetchers=fetchers)


def _bring(landed: LandedMission, collector: PhotoCollector) -> None:
    async def main() -> None:
        with closing(landed):
            await collector.run_until_done(_flushed)

    async def _flushed() -> None:
        await landed.flush()

    asyncio.run(main())


def test_files_come_after_landing_newest_first_and_are_in_journal_and_manifest(tmp_path: Path) -> None:
    landed = _landed(tmp_path)
    fetcher, ended = FakeFetcher(), landed.record.seq
    _bring(landed, _collector(landed, fetcher))
    assert fetcher.asked == [f"IMG_{n:04d}.jpg" for n in (3, 2, 1, 0)]
    directory = landed.directory
    record = record_of(directory, load_journal(directory.journal))
    assert record.seq == ended + 4
    assert record.state is MissionState.COMPLETE
    assert not wanted_files(record)
    assert restore_manifest(directory)
    manifest = read_manifest(directory.manifest)
    assert sorted(shot["file"] for shot in manifest["shots"]) == [f"images/IMG_{n:04d}.jpg" for n in (0, 1, 2, 3)]
    assert manifest["certificate"]["certified"] is not None
    assert not (directory.path / ".incoming").exists()


def test_troubles_are_tried_again_unless_they_are_final(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(photo_collector, "_FIRST_PAUSE_S", 0.001)
    landed = _landed(tmp_path)
    page, later, no = b"<html>", PhotoFileError("404"), PhotoFileError("redirects elsewhere", final=True)
    fetcher = FakeFetcher(no, later, page, page, page)
    collector = _collector(landed, fetcher)
    _bring(landed, collector)
    assert fetcher.asked.count("IMG_0003.jpg") == 1, "final"
    stored = {event.file for event in photo_collector_events(landed)}
    assert "images/IMG_0003.jpg" not in stored
    assert len(stored) >= 2
    assert "redirects elsewhere" in collector.problems.values()
    assert not list((landed.directory.path / "images").glob("*html*"))


def photo_collector_events(landed: LandedMission) -> list[ev.PhotoStored]:
    contents = load_journal(landed.directory.journal)
    return [event for event in contents.events if isinstance(event, ev.PhotoStored)]


def test_a_photo_is_stored_while_the_mission_flies(tmp_path: Path) -> None:
    async def main() -> MissionSession:
        return await _fly(tmp_path, FakeFetcher())

    session = run_virtual(main())
    landed = LandedMission.read(session.stored.directory)
    landed.close()
    left = {one.url for one in wanted_files(landed.record)}
    stored = {event.file.removeprefix("images/") for event in photo_collector_events(landed)}
    assert left | stored == {f"IMG_{n:04d}.jpg" for n in (0, 1, 2, 3)}
    assert not left & stored


def test_a_rejected_attempt_is_not_wanted_and_a_folder_elsewhere_is_not_read(tmp_path: Path) -> None:
    landed = _landed(tmp_path)
    landed.close()
    record = landed.record
    newest = wanted_files(record)[0]
    record.apply(
        ev.ShotRevoked(
            shot=newest.shot, attempt=newest.attempt, code="evidence", reason="", seq=record.seq + 1, state=record.state
        )
    )
    assert newest not in wanted_files(record)

    inside, outside = tmp_path / "in" / "1.jpg", tmp_path / "out.jpg"
    inside.parent.mkdir()
    inside.write_bytes(a_jpeg())
    outside.write_bytes(a_jpeg())
    (inside.parent / "link.jpg").symlink_to(outside)
    files = LocalFiles((inside.parent,))

    async def main() -> None:
        assert await files.fetch(inside.as_uri(), tmp_path / "part") == inside
        for url in (outside.as_uri(), (inside.parent / "link.jpg").as_uri(), f"file://host{inside}"):
            with pytest.raises(PhotoFileError) as error:
                await files.fetch(url, tmp_path / "part")
            assert error.value.final
        with pytest.raises(PhotoFileError) as error:
            await files.fetch((inside.parent / "2.jpg").as_uri(), tmp_path / "part")
        assert not error.value.final

    asyncio.run(main())


def test_a_journal_that_was_continued_meanwhile_is_left_alone(tmp_path: Path) -> None:
    landed = _landed(tmp_path)
    other = LandedMission.read(landed.directory)
    first = wanted_files(landed.record)[0]

    async def store(one: LandedMission, shade: int) -> None:
        await one.photos.store(
            a_jpeg(shade), shot=first.shot, attempt=first.attempt, name=f"{shade}.jpg", source="http"
        )
        await one.flush()

    async def main() -> None:
        with closing(landed), closing(other):
            await store(landed, 1)
            with pytest.raises(JournalFileError, match="continued meanwhile"):
                await store(other, 2)

    asyncio.run(main())
    assert [event.file for event in photo_collector_events(landed)] == ["images/1.jpg"]
    assert replace(photo_collector_events(landed)[0], seq=0).state is MissionState.COMPLETE
