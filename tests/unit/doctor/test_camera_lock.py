"""The doctor tries the settings of [camera.lock] and puts them back."""

from __future__ import annotations

import pytest

from panoexec.doctor.camera import _examine_lock
from panoexec.doctor.findings import Findings
from panoexec.errors import DeviceError
from panoexec.inputs.config import Config
from panoexec.inputs.vehicle_sections import CameraSection, LockSection


class Camera:
    """Prepares as a test wants."""

    def __init__(self, problem: str | DeviceError) -> None:
        self.problem = problem
        self.done: list[str] = []

    async def prepare(self) -> str:
        self.done.append("prepare")
        if isinstance(self.problem, DeviceError):
            raise self.problem
        return self.problem

    async def restore(self) -> None:
        self.done.append("restore")


@pytest.mark.parametrize(
    ("problem", "level", "text"),
    [
        ("", "ok", "can be made, and were put back"),
        ("it tells no camera definition", "missing", "it tells no camera definition"),
        (DeviceError("the camera does not answer"), "missing", "the camera does not answer"),
    ],
)
async def test_what_a_camera_does_with_the_lock_is_found(problem: str | DeviceError, level: str, text: str) -> None:
    camera, findings = Camera(problem), Findings()
    config = Config(camera=CameraSection(lock=LockSection(focus="manual")))
    await _examine_lock(camera, config, findings)  # type: ignore[arg-type]
    assert camera.done == ["prepare", "restore"]
    (found,) = findings.all
    assert (found.check, found.verdict.value) == ("lock", level)
    assert text in found.found


async def test_without_a_lock_the_camera_is_left_alone() -> None:
    camera, findings = Camera(""), Findings()
    await _examine_lock(camera, Config(), findings)  # type: ignore[arg-type]
    assert camera.done == []
    assert findings.all == []
