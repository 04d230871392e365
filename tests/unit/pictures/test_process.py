"""The process that examines photos: verdicts pass it unchanged, and it does not outlive its parent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from panoexec.angles import quaternion_from_rotation
from panoexec.errors import DeviceError
from panoexec.pictures.model import Content
from panoexec.pictures.process import PictureProcess
from panoexec.planning.model import Plan
from tests.support.photo_sets import photo_set
from tests.unit.pictures.conftest import SCENE


async def test_photos_are_examined_in_the_process(two_rows: Plan, tmp_path: Path) -> None:
    photos = photo_set(two_rows, seed=2, faults={2: "photo-black"}, **SCENE).photos[:5]
    async with PictureProcess.running(two_rows.camera) as checker:
        for photo in photos:
            path = tmp_path / f"{photo.shot}.jpg"
            path.write_bytes(photo.content)
            found = await checker.add(photo.shot, path, quaternion_from_rotation(photo.measured).tolist(), photo.time_s)
        assert found.photos[2].verdict is Content.EXPOSURE
        assert {0, 1, 3, 4} == {shot for shot, judged in found.photos.items() if judged.verdict is Content.OK}
        assert found.graph.edges
        found = await checker.add(4, tmp_path / "gone.jpg", (1.0, 0.0, 0.0, 0.0), 0.0)
        assert found.photos[4].verdict is Content.UNREADABLE
        found = await checker.condemn(3, Content.UNREADABLE, "cut off", (1.0, 0.0, 0.0, 0.0), float("nan"))
        assert found.photos[3].reason == "cut off"
        found = await checker.drop([2, 3, 4])
        assert set((await checker.judge(final=True)).photos) == {0, 1}
        pid = checker.pid
        assert os.getpriority(os.PRIO_PROCESS, pid) >= 10
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(DeviceError):
        await checker.judge()
