"""Cameras as they are found in the field, over real sockets: in the wrong mode, beside others, deferred, PX4's own."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.errors import DeviceError
from panoexec.mission.protocols import MayFireLate, PacesPhotos, PreparesForPhotos
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.scripted_peer import ACCEPTED, DENIED, FAILED, UNSUPPORTED, ScriptedPeer, listening
from tests.wire.test_mavsdk_camera import LONG_S, SHOOT, CameraPeer

CLOCK = SystemClock()
SET_MODE, DIGICAM = 530, 203
COUNTED = EvidenceLevel.COUNTED


class ModalPeer(CameraPeer):
    """A camera with modes.

    Attributes:
        mode: CAMERA_MODE.
        obeys: whether a change of mode that it accepts is made.
    """

    def __init__(self, mode: int = 1) -> None:
        super().__init__()
        self.mode = mode
        self.obeys = True
        self.answers[SET_MODE] = self._set_mode
        self.builders[260] = lambda: mavlink.MAVLink_camera_settings_message(self.camera_ms(), self.mode)
        inner = self.builders[259]

        def information() -> Any:
            message = inner()
            message.flags = 1 | 2 | 4
            return message

        self.builders[259] = information

    def _set_mode(self, command: Any) -> int:
        if self.obeys:
            self.mode = int(command.param2)
        return ACCEPTED


class Px4Peer(ScriptedPeer):
    """A PX4 with its own trigger: no camera answers.

    Attributes:
        triggers: how often the contact was closed.
    """

    def __init__(self, trigger_mode: int | None) -> None:
        super().__init__()
        if trigger_mode is not None:
            self.parameters |= {"TRIG_MODE": trigger_mode}
        self.triggers = 0
        self.answers[DIGICAM] = self._digicam

    def send(self, message: Any, component: int = 1) -> None:
        if message.get_type() == "HEARTBEAT" and component == 1:
            message.autopilot = mavlink.MAV_AUTOPILOT_PX4
        super().send(message, component)

    def _parameter(self, request: Any) -> None:
        """As PX4 does: an integer's bytes are sent as those of a float."""
        if request.param_id in self.parameters:
            bits = struct.unpack("<f", struct.pack("<i", int(self.parameters[request.param_id])))[0]
            kind = mavlink.MAV_PARAM_TYPE_INT32
            self.send(mavlink.MAVLink_param_value_message(request.param_id.encode(), bits, kind, 1, 0))

    def _digicam(self, command: Any) -> int:
        if command.param5 != 1.0:
            return UNSUPPORTED
        self.triggers += 1
        report = mavlink.MAVLink_camera_image_captured_message(
            self.boot_ms(), 0, 0, 473977420, 85455940, 518000, 30000, [1, 0, 0, 0], self.triggers, -1, b""
        )
        asyncio.get_running_loop().call_later(0.03, self.send, report)
        return ACCEPTED


@asynccontextmanager
async def camera_of(peer: ScriptedPeer, **options: Any) -> AsyncIterator[MavsdkCamera]:
    async with (
        listening(peer),
        MavsdkLink(peer.url, clock=CLOCK) as link,
        MavsdkCamera(link, **options) as camera,
    ):
        await link.wait_autopilot(60)
        yield camera


async def test_photo_mode_is_set_verified_and_restored() -> None:
    peer = ModalPeer()
    async with camera_of(peer) as camera:
        await camera.discover()
        assert isinstance(camera, PreparesForPhotos)
        assert camera.mode is not None
        assert camera.mode.text == "video mode"
        assert peer.sent(SET_MODE) == [], "looking changes nothing"
        assert await camera.prepare() == ""
        assert peer.mode == 0
        assert await camera.prepare() == "", "once is enough"
        assert len(peer.sent(SET_MODE)) == 1
        await camera.restore()
        assert peer.mode == 1
        await camera.restore()
        assert len(peer.sent(SET_MODE)) == 2


@pytest.mark.parametrize("mode", [0, 2])
async def test_a_camera_that_takes_photos_is_left_alone(mode: int) -> None:
    peer = ModalPeer(mode)
    async with camera_of(peer) as camera:
        assert await camera.prepare() == ""
        await camera.restore()
        assert peer.sent(SET_MODE) == []


def _refuses(peer: ModalPeer) -> None:
    peer.answers[SET_MODE] = lambda _: DENIED


def _pretends(peer: ModalPeer) -> None:
    peer.obeys = False


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (_refuses, "changing its mode (530): denied"),
        (_pretends, "it accepted a change of its mode (530), but did not make it"),
    ],
)
async def test_a_camera_that_stays_in_video_mode_is_named(change: Callable[[ModalPeer], None], why: str) -> None:
    peer = ModalPeer()
    change(peer)
    async with camera_of(peer) as camera:
        assert await camera.prepare() == f"the camera is in video mode and stays there: {why}"


async def test_an_autopilot_that_fails_and_takes_the_photo_later_is_waited_for() -> None:
    """ArduPilot with CAM1_INTRVAL_MIN."""
    peer = CameraPeer(component=1)
    peer.parameters |= {"CAM1_FEEDBAK_PIN": -1, "CAM1_INTRVAL_MIN": 8}

    def later(command: Any) -> int:
        del command
        peer.images += 1
        asyncio.get_running_loop().call_later(0.6, peer.send, peer.feedback(peer.images))
        return FAILED

    async with camera_of(peer, component=1) as camera:
        await camera.discover()
        assert isinstance(camera, PacesPhotos)
        assert camera.interval_s == pytest.approx(8.05)
        peer.answers[SHOOT] = later
        capture = await camera.trigger()
        assert isinstance(capture, MayFireLate)
        assert await capture.fired() - capture.commanded_s > 0.5
        evidence = await capture.evidence(COUNTED, LONG_S)
        assert (evidence.level, evidence.image_index) == (COUNTED, 1)
        assert evidence.exposed_s - capture.commanded_s > 0.5
        peer.answers[SHOOT] = lambda _: FAILED  # and this one is not taken at all
        camera._reports.deferral.told_s = 1.0
        with pytest.raises(DeviceError, match="taking a photo"):
            await camera.trigger()
        assert camera.surplus_photos == 0


async def test_an_accepted_trigger_of_the_autopilot_is_held_until_it_is_done() -> None:
    peer = CameraPeer(component=1)
    peer.parameters |= {"CAM1_FEEDBAK_PIN": -1, "CAM1_INTRVAL_MIN": 8}
    peer.report_s = None
    async with camera_of(peer, component=1) as camera:
        capture = await camera.trigger()
        assert isinstance(capture, MayFireLate)
        asyncio.get_running_loop().call_later(0.7, lambda: peer.send(peer.reported[-1]))
        fired_s = await capture.fired()
        assert CLOCK.monotonic() - capture.commanded_s >= 0.65
        assert fired_s - capture.commanded_s >= 0.65


async def test_px4s_own_trigger_is_used_where_no_camera_answers() -> None:
    peer = Px4Peer(1)
    async with camera_of(peer) as camera:
        found = await camera.discover()
        assert found.label == "PX4's camera trigger, component 1"
        assert found.why == "TRIG_MODE 1, and no camera answers"
        assert await camera.best_evidence() is COUNTED
        for number in (1, 2):
            capture = await camera.trigger()
            evidence = await capture.evidence(COUNTED, LONG_S)
            assert (evidence.level, evidence.image_index) == (COUNTED, number)
        assert [command.param5 for command in peer.sent(DIGICAM)] == [1.0, 1.0]


async def test_px4s_trigger_that_fires_by_itself_is_refused_plainly() -> None:
    async with camera_of(Px4Peer(2)) as camera:
        with pytest.raises(DeviceError, match="fires by itself \\(TRIG_MODE 2\\)"):
            await camera.discover()
