"""What a new process learns from a camera of the photos that an earlier one took, over real sockets."""

from __future__ import annotations

import time
from typing import Any

import pytest

from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel, PendingCapture
from panoexec.errors import DeviceError
from panoexec.mission.protocols import PhotoRecall
from tests.wire.scripted_peer import ACCEPTED, DENIED, listening
from tests.wire.test_mavsdk_camera import LONG_S, CameraPeer

CLOCK = SystemClock()
CAPTURED = EvidenceLevel.CAPTURE_MESSAGE
FAR_UTC_S = 1_795_330_661.5
"""What the peer's cameras take for the time."""


class RememberingPeer(CameraPeer):
    """Tells each of its photos again, by index as the protocol has it."""

    def __init__(self, component: int = 100) -> None:
        super().__init__(component)
        self.parameters["CAM1_FEEDBAK_PIN"] = -1
        if component <= 6:
            self.builders[180] = lambda: self.reported[-1]

    def _request(self, command: Any) -> int | None:
        if command.param1 != 263:
            return super()._request(command)
        found = next((photo for photo in self.reported if photo.image_index == command.param2), None)
        if found is None:
            return DENIED
        self.send(found, self.component)
        return ACCEPTED


async def _first_life(peer: CameraPeer, photos: int) -> list[float]:
    """Photos of an earlier process; the wall times of their triggers."""
    times = []
    async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link, component=peer.component) as camera:
        await link.wait_autopilot(60)
        for _ in range(photos):
            capture: PendingCapture = await camera.trigger()
            times.append(time.time() - (CLOCK.monotonic() - capture.commanded_s))
    return times


async def test_the_last_photos_are_told_with_their_times() -> None:
    async with listening(RememberingPeer()) as peer:
        triggers = await _first_life(peer, 5)
        async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link) as camera:
            await link.wait_autopilot(60)
            assert isinstance(camera, PhotoRecall)
            found = await camera.recall()
            assert found.image_count == 5
            assert [photo.evidence.image_index for photo in found.photos] == [1, 2, 3, 4, 5][-len(found.photos) :]
            assert len(found.photos) >= 4
            last = found.photos[-1]
            assert (last.evidence.level, last.evidence.file_url) == (CAPTURED, "5.jpg")
            # by the camera's boot clock; what it takes for the time of day is years off
            assert last.exposed_utc_s == pytest.approx(triggers[-1], abs=20.0)
            assert camera.surplus_photos == 0
            # and its next photo is proven as ever
            capture = await camera.trigger()
            assert (await capture.evidence(CAPTURED, LONG_S)).image_index == 6


async def test_stamps_from_before_a_reboot_of_the_camera_are_not_believed() -> None:
    async with listening(RememberingPeer()) as peer:
        await _first_life(peer, 1)
        peer.camera_boot_s = 0.0
        peer.boot_at = time.monotonic()
        async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link) as camera:
            await link.wait_autopilot(60)
            found = await camera.recall()
            assert [photo.exposed_utc_s for photo in found.photos] == pytest.approx([FAR_UTC_S])


async def test_an_autopilot_tells_its_last_trigger() -> None:
    async with listening(RememberingPeer(component=1)) as peer:
        await _first_life(peer, 2)
        async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link, component=1) as camera:
            await link.wait_autopilot(60)
            found = await camera.recall()
            assert found.image_count == 2
            (photo,) = found.photos
            assert (photo.evidence.image_index, photo.evidence.level) == (2, EvidenceLevel.COUNTED)
            assert photo.exposed_utc_s == pytest.approx(FAR_UTC_S)


async def test_a_camera_that_only_counts_tells_its_count() -> None:
    async with listening(CameraPeer(component=1)) as peer:
        peer.parameters["CAM1_FEEDBAK_PIN"] = -1
        await _first_life(peer, 2)
        async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link, component=1) as camera:
            await link.wait_autopilot(60)
            found = await camera.recall()
            assert (found.photos, found.image_count) == ((), 2)


async def test_the_count_before_a_trigger_is_known_only_if_it_includes_every_photo() -> None:
    async with listening(CameraPeer()) as peer:
        peer.report_s, peer.counted = None, 0
        del peer.builders[263]
        async with MavsdkLink(peer.url, clock=CLOCK) as link, MavsdkCamera(link) as camera:
            await link.wait_autopilot(60)
            await camera.recall()
            assert camera.image_count == 0
            capture = await camera.trigger()
            assert camera.image_count == -1  # taken, but not counted yet
            peer.counted = None
            assert (await capture.evidence(EvidenceLevel.COUNTED, LONG_S)).level is EvidenceLevel.COUNTED
            assert camera.image_count == 1


async def test_a_camera_that_says_nothing_is_a_device_error() -> None:
    async with (
        listening(CameraPeer()) as peer,
        MavsdkLink(peer.url, clock=CLOCK) as link,
        MavsdkCamera(link) as camera,
    ):
        await link.wait_autopilot(60)
        await camera.discover()
        del peer.builders[262]
        with pytest.raises(DeviceError, match="CAMERA_CAPTURE_STATUS"):
            await camera.recall()
