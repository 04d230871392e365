"""Photos in the mission directory: whole, hashed, told once, never under another photo's name."""

from __future__ import annotations

import asyncio
import hashlib
import io
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from panoexec.devices import EvidenceLevel
from panoexec.errors import PanoexecError, UsageError
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.planning.model import Shot
from panoexec.store import photo_store
from panoexec.store.manifest import read_manifest
from panoexec.store.photo_store import PhotoNotRecordedError, PhotoRefusedError, PhotoStore, hash_file
from panoexec.store.session import Devices, MissionSession, create_mission, open_mission
from tests.unit.fakes.flying import until_event
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import a_world


def a_jpeg(shade: int = 0) -> bytes:
    out = io.BytesIO()
    Image.new("L", (16, 12), shade).save(out, "JPEG")
    return out.getvalue()


class _Book:
    """A record with two shots, one attempt each, and what was emitted."""

    def __init__(self) -> None:
        shots = [Shot(index=i, row=0, pitch_deg=0.0, yaw_deg=0.0) for i in range(2)]
        self.record = MissionRecord(mission_id="m1", shots=shots)
        self.events: list[ev.PhotoStored] = []
        self.open = True
        for shot in shots:
            self._apply(ev.ShotStarted(shot=shot.index, attempt=1, round=0, pitch_deg=0, yaw_deg=0, patience_s=1))
            self._apply(ev.ShotRejected(shot=shot.index, attempt=1, code="crash", reason=""))

    def _apply(self, event: Any) -> Any:
        stamped = replace(event, seq=self.record.seq + 1)
        self.record.apply(stamped)
        return stamped

    def emit(self, event: ev.PhotoStored) -> ev.PhotoStored | None:
        if not self.open:
            return None
        self.events.append(self._apply(event))
        return self.events[-1]


def _with_store(folder: Path, work: Callable[[PhotoStore, _Book], Awaitable[None]]) -> _Book:
    book = _Book()

    async def main() -> None:
        with closing(PhotoStore(folder, record=book.record, emit=book.emit)) as store:
            await work(store, book)

    asyncio.run(main())
    return book


@pytest.mark.parametrize("how", ["bytes", "copy", "move", "link", "in place"])
def test_a_photo_is_stored_whole_with_its_hash(tmp_path: Path, how: Any) -> None:
    data, card, mission = a_jpeg(), tmp_path / "card.jpg", tmp_path / "mission"
    mission.mkdir()
    if how == "in place":
        (mission / "images").mkdir()
        card = mission / "images" / "DSC01.JPG"
    card.write_bytes(data)

    async def work(store: PhotoStore, book: _Book) -> None:
        if how == "bytes":
            stored = await store.store(data, shot=1, attempt=1, name="/DCIM/100/DSC01.JPG", source="http")
        else:
            via: Any = "copy" if how == "in place" else how
            stored = await store.store(card, shot=1, attempt=1, name=r"C:\DCIM\DSC01.JPG", source="import", how=via)
        assert (stored.file, stored.size_bytes) == ("images/DSC01.JPG", len(data))
        assert stored.sha256 == hashlib.sha256(data).hexdigest()
        assert (mission / stored.file).read_bytes() == data
        assert card.exists() is (how != "move")
        assert [path.name for path in (mission / "images").iterdir()] == ["DSC01.JPG"]
        assert store.stored(1, 1) == stored
        if how in {"copy", "link"}:
            assert (card.stat().st_ino == (mission / stored.file).stat().st_ino) is (how == "link")
            assert (mission / stored.file).stat().st_mode & 0o777 == 0o666 & ~0o022 or how == "link"

    assert len(_with_store(mission, work).events) == 1


def test_the_same_photo_again_adds_no_event_unless_the_first_one_was_lost(tmp_path: Path) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        book.open = False
        with pytest.raises(PhotoNotRecordedError):
            await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")
        book.open = True
        first = await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")
        again = await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")
        assert first == again == book.events[0]
        assert len(book.events) == 1

    _with_store(tmp_path, work)


def test_a_name_that_is_taken_stays_with_its_photo(tmp_path: Path) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        one = await store.store(a_jpeg(1), shot=0, attempt=1, name="a.jpg", source="http")
        two = await store.store(a_jpeg(2), shot=1, attempt=1, name="a.jpg", source="http")
        assert (one.file, two.file) == ("images/a.jpg", "images/a-0001-1-1.jpg")
        assert (tmp_path / one.file).read_bytes() == a_jpeg(1)
        assert (tmp_path / two.file).read_bytes() == a_jpeg(2)
        (tmp_path / "images" / "b.jpg").write_bytes(b"the user's own")
        three = await store.store(a_jpeg(3), shot=1, attempt=1, name="b.jpg", source="import")
        assert three.file == "images/b-0001-1-1.jpg"
        assert (tmp_path / "images" / "b.jpg").read_bytes() == b"the user's own"

    _with_store(tmp_path, work)


def test_one_photo_counts_once(tmp_path: Path) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")
        for name in ("a.jpg", "b.jpg"):
            with pytest.raises(PhotoRefusedError, match=r"shot 0, attempt 1.*one photo counts once"):
                await store.store(a_jpeg(), shot=1, attempt=1, name=name, source="http")
        assert [path.name for path in (tmp_path / "images").iterdir()] == ["a.jpg"]

    assert len(_with_store(tmp_path, work).events) == 1


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty"),
        (b"\n<!DOCTYPE html><html>", "is a web page, not an image"),
        (b"\xff\xd8\xff\xe0\x00", "cut off"),
        (a_jpeg()[:-2], "cut off"),
        (b"hello world, not an image", "is not an image"),
    ],
)
def test_what_is_no_whole_image_leaves_nothing(tmp_path: Path, content: bytes, problem: str) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        with pytest.raises(PhotoRefusedError, match=problem):
            await store.store(content, shot=0, attempt=1, name="a.jpg", source="http")
        card = tmp_path / "card.jpg"
        card.write_bytes(content)
        for how in ("copy", "move", "link"):
            with pytest.raises(PhotoRefusedError, match=rf"card\.jpg: .*{problem}"):
                await store.store(card, shot=0, attempt=1, name="a.jpg", source="import", how=how)
        assert card.exists()
        assert not list((tmp_path / "images").iterdir())

    assert not _with_store(tmp_path, work).events


def test_sizes_are_bounded_and_as_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        with pytest.raises(PhotoRefusedError, match=f"has {len(a_jpeg())} bytes, the camera told 5"):
            await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http", expected_bytes=5)
        monkeypatch.setattr(photo_store, "MAX_PHOTO_BYTES", 99)
        with pytest.raises(PhotoRefusedError, match="at most 99"):
            await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")
        with pytest.raises(UsageError, match=r"gone\.jpg: No such file"):
            await store.store(tmp_path / "gone.jpg", shot=0, attempt=1, name="a.jpg", source="import")
        with pytest.raises(LookupError):
            await store.store(a_jpeg(), shot=0, attempt=2, name="a.jpg", source="http")

    assert not _with_store(tmp_path, work).events


def test_names_cannot_leave_the_folder(tmp_path: Path) -> None:
    async def work(store: PhotoStore, book: _Book) -> None:
        for shade, name in enumerate(("../../up.jpg", "..", ".hidden.jpg", "a/b\n;c.jpg", "x" * 300 + ".jpg", "")):
            stored = await store.store(a_jpeg(shade), shot=0, attempt=1, name=name, source="http")
            path = (tmp_path / stored.file).resolve()
            assert path.parent == tmp_path / "images"
            assert not path.name.startswith(".")
            assert path.suffix == ".jpg"

    _with_store(tmp_path, work)


def test_a_read_only_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "images").write_text("a file where the folder should be")

    async def work(store: PhotoStore, book: _Book) -> None:
        with pytest.raises(PanoexecError, match=r"images: File exists"):
            await store.store(a_jpeg(), shot=0, attempt=1, name="a.jpg", source="http")

    _with_store(tmp_path, work)


@asynccontextmanager
async def _flown(storage: Path) -> AsyncIterator[tuple[Any, Any]]:
    async with a_world() as world:
        stored = await create_mission(storage, plan=world.plan, settings=world.settings, now_utc_s=0.0)
        devices = Devices(gimbal=world.gimbal, camera=world.camera, vehicle=world.vehicle)
        opened = MissionSession.opened(stored, devices=devices, clock=world.clock, sink=world.sink, vehicle={})
        async with opened as session:
            yield world, session


def test_a_photo_that_is_stored_in_flight_is_in_the_manifest_and_survives_the_process(tmp_path: Path) -> None:
    async def main() -> None:
        async with _flown(tmp_path) as (world, session), asyncio.TaskGroup() as group:

            async def store() -> None:
                await until_event(world, ev.ShotAccepted, 2)
                accepted = world.sink.of(ev.ShotAccepted)[0]
                await session.photos.store(
                    a_jpeg(), shot=accepted.shot, attempt=accepted.attempt, name="x.jpg", source="http"
                )
                session.mission.commands.interrupt()

            group.create_task(store(), name="store")
            await session.run()
        (event,) = world.sink.of(ev.PhotoStored)
        manifest = read_manifest(session.stored.directory.manifest)
        shot = manifest["shots"][event.shot]
        assert (shot["file"], shot["sha256"]) == (event.file, event.sha256) == (event.file, hash_file(
            session.stored.directory.path / event.file)[1])  # fmt: skip
        photo = shot["attempts"][0]["photos"][0]
        assert (photo["told"][:4], photo["source"], photo["evidence"]) == ("IMG_", "http", "file_seen")
        again = await open_mission(session.stored.directory)
        await again.journal.close()
        record = MissionRecord.from_events(mission_id="m", shots=again.plan.shots, events=again.events)
        attempt = record.shots[event.shot].attempts[0]
        assert attempt.stored == {1: event}
        assert attempt.evidence is EvidenceLevel.FILE_SEEN

    run_virtual(main())
