"""Thumbnails: small, kept, published within the budget and as the link has room, and again on request."""

from __future__ import annotations

import asyncio
import io
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import PIL.Image
import pytest

from panoexec.daemon.errors import MissionStorageError
from panoexec.daemon.thumbnail_worker import MOST_BYTES, thumbnail
from panoexec.daemon.thumbnails import Thumbnails
from panoexec.inputs.config import Config
from panoexec.mission.log.events import PhotoStored
from panoexec.mqtt.link import MqttLink
from panoexec.mqtt.topics import Topics
from tests.waiting import eventually

MISSION = "20260921T141320.000Z"


class FakeLink:
    """Takes what is spare, unless it is busy."""

    def __init__(self) -> None:
        self.topics = Topics("panoexec", "drone")
        self.busy = False
        self.sent: list[tuple[str, bytes]] = []
        self.times: list[float] = []

    async def publish_spare(self, topic: str, payload: bytes) -> bool:
        if self.busy:
            return False
        self.sent.append((topic.removeprefix("panoexec/drone/thumbnail/"), payload))
        self.times.append(asyncio.get_running_loop().time())
        return True


def a_photo(path: Path, shade: int, *, noise: bool = False) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((400, 600, 3), shade, dtype=np.uint8)
    if noise:
        pixels = np.random.default_rng(1).integers(0, 256, (1200, 1800, 3), dtype=np.uint8)
    PIL.Image.fromarray(pixels).save(path, "JPEG", quality=95)


def stored(shot: int) -> PhotoStored:
    return PhotoStored(
        mission_id=MISSION, shot=shot, attempt=1, file=f"images/{shot}.jpg", size_bytes=1, sha256="", source="http"
    )


@asynccontextmanager
async def _running(storage: Path, link: FakeLink | None, **pictures: Any) -> AsyncIterator[Thumbnails]:
    config = Config.model_validate({"storage": {"path": str(storage)}, "pictures": pictures})
    made = Thumbnails(config=lambda: config, mqtt=cast("MqttLink | None", link))
    task = asyncio.create_task(made.run(), name="thumbnails")
    try:
        yield made
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The mission directory, with three photos and one that is none."""
    mission = tmp_path / "missions" / MISSION
    for shot in range(3):
        a_photo(mission / "images" / f"{shot}.jpg", 60 * shot)
    (mission / "images" / "3.jpg").write_bytes(b"no photo")
    return mission


def test_a_thumbnail_of_anything_is_small_enough_and_upright(tmp_path: Path) -> None:
    path = tmp_path / "noise.jpg"
    a_photo(path, 0, noise=True)
    assert len(thumbnail(path)) <= MOST_BYTES
    turned = PIL.Image.new("RGB", (60, 40))
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    turned.save(path, "JPEG", exif=exif)
    with PIL.Image.open(io.BytesIO(thumbnail(path))) as opened:
        assert opened.height > opened.width


async def test_they_are_made_kept_and_published_the_newest_first_and_again(tmp_path: Path, folder: Path) -> None:
    link = FakeLink()
    link.busy = True
    async with _running(tmp_path, link) as made:
        for shot in (0, 3, 1, 2):
            made.publish(stored(shot))
        await eventually(lambda: len(list(folder.glob("thumbnails/*.jpg"))) == 3, 60)
        assert link.sent == []
        link.busy = False
        await eventually(lambda: len(link.sent) == 3, 60)
        assert {topic for topic, _ in link.sent} == {f"{MISSION}/{shot}" for shot in range(3)}
        for topic, payload in link.sent:
            assert payload == (folder / "thumbnails" / f"{topic.rpartition('/')[2]}.jpg").read_bytes()
        assert await made.send_again(MISSION, [2, 0, 77]) == 2
        await eventually(lambda: len(link.sent) == 5, 60)
        assert [topic for topic, _ in link.sent[3:]] == [f"{MISSION}/0", f"{MISSION}/2"]
        with pytest.raises(MissionStorageError, match="there is no mission"):
            await made.send_again("20200101T000000.000Z", None)


class _Counted(list[int]):
    """Shots of a request, and how often they were gone through."""

    gone_through = 0

    def __iter__(self) -> Iterator[int]:
        self.gone_through += 1
        return super().__iter__()


async def test_a_long_request_is_gone_through_once(tmp_path: Path, folder: Path) -> None:
    """10 000 shots, asked of a mission with 2000 thumbnails, stopped the event loop for 3 s."""
    (folder / "thumbnails").mkdir()
    for shot in range(50):
        (folder / "thumbnails" / f"{shot}.jpg").write_bytes(b"x")
    asked = _Counted(range(10_000))
    config = Config.model_validate({"storage": {"path": str(tmp_path)}})
    assert await Thumbnails(config=lambda: config, mqtt=None).send_again(MISSION, asked) == 50
    assert asked.gone_through == 1


async def test_the_budget_holds(tmp_path: Path, folder: Path) -> None:
    link = FakeLink()
    async with _running(tmp_path, link, thumbnail_bytes_s=4000) as made:
        for shot in range(3):
            made.publish(stored(shot))
        await eventually(lambda: len(link.sent) == 3, 60)
    for (_, payload), before, after in zip(link.sent, link.times, link.times[1:], strict=False):
        assert after - before >= len(payload) / 4000 - 0.01


@pytest.mark.parametrize(("choice", "kept"), [("local", 1), ("off", 0)])
async def test_local_ones_are_not_published_and_off_makes_none(
    tmp_path: Path, folder: Path, choice: str, kept: int
) -> None:
    link = FakeLink()
    async with _running(tmp_path, link, thumbnails=choice) as made:
        made.publish(stored(1))
        await eventually(lambda: len(list(folder.glob("thumbnails/*.jpg"))) == kept and not made._to_make, 60)
        assert not made._to_send
    assert link.sent == []
