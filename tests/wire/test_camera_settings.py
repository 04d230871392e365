"""`[camera.lock]` on MAVLink cameras over real sockets: by their camera definition, and on those that have none."""

from __future__ import annotations

import asyncio
import os
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.camera.settings import extended_parameters
from panoexec.adapters.camera.settings.extended_parameters import ExtendedParameters
from panoexec.adapters.link.file_urls import FileUrls
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.no_downloads import no_downloads
from panoexec.clock import SystemClock
from panoexec.errors import DeviceError
from panoexec.inputs.vehicle_sections import LockSection
from panoexec.mission.protocols import MetersExposure, PreparesForPhotos
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.camera_settings import definition
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.photos import file_server
from panoexec.sim.photos.file_server import serving_photos
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.wire.scripted_peer import listening
from tests.wire.test_mavsdk_camera import CameraPeer

CLOCK = SystemClock()
BALANCE = LockSection(white_balance="Daylight")
MANUAL = LockSection(exposure="manual", shutter_s=0.0021, aperture=8, iso=200, white_balance="daylight", focus="manual")


class SettingsPeer(CameraPeer):
    """A camera with one setting, CAM_WBMODE, that obeys as a test wants.

    Attributes:
        value: of the setting.
        obeys: whether an accepted value is taken over.
        results: PARAM_ACK of the coming answers, the last one for all that follow; None is no answer.
        mute: so many requests for the value are not answered.
    """

    def __init__(self, uri: str) -> None:
        super().__init__()
        self.definition_uri = uri
        self.value = 0
        self.obeys = True
        self.results: list[int | None] = [0]
        self.mute = 0

    def data_received(self, data: bytes) -> None:
        before = len(self.others)
        super().data_received(data)
        for message in self.others[before:]:
            if message.get_type().startswith("PARAM_EXT_") and getattr(message, "param_id", "") == "CAM_WBMODE":
                self._answer(message)

    def _answer(self, message: Any) -> None:
        packed = struct.pack("<I", self.value).ljust(128, b"\0")
        if message.get_type() == "PARAM_EXT_REQUEST_READ":
            self.mute -= 1
            if self.mute < 0:
                value = mavlink.MAVLink_param_ext_value_message(b"CAM_WBMODE", packed, 5, 1, 0)
                self.send(value, self.component)
            return
        result = self.results.pop(0) if len(self.results) > 1 else self.results[0]
        if result == mavlink.PARAM_ACK_ACCEPTED and self.obeys:
            self.value = message.get_msgbuf()[28]
        if result is not None:
            ack = mavlink.MAVLink_param_ext_ack_message(b"CAM_WBMODE", packed, 5, result)
            self.send(ack, self.component)


@asynccontextmanager
async def camera_of(peer: CameraPeer, lock: LockSection, *, hosts: tuple[str, ...] = ()) -> AsyncIterator[MavsdkCamera]:
    async with (
        listening(peer),
        MavsdkLink(peer.url, clock=CLOCK, files=FileUrls(hosts=hosts)) as link,
        MavsdkCamera(link, lock=lock) as camera,
    ):
        await link.wait_autopilot(60)
        yield camera


async def test_the_simulated_cameras_settings_are_made_read_back_and_put_back() -> None:
    port = free_udp_port()
    simulation = settings.changed(SimConfig(port=port), ["camera.definition=http"])
    files = FileUrls(hosts=["127.0.0.1"])
    async with (
        running_simulator(simulation),
        MavsdkLink(f"udpin://127.0.0.1:{port}", clock=CLOCK, files=files) as link,
        MavsdkCamera(link, lock=MANUAL) as camera,
    ):
        await link.wait_autopilot(60)
        told = ExtendedParameters(link, component=lambda: 100)

        async def values() -> dict[str, float | str]:
            names = ("CAM_EXPMODE", "CAM_SHUTTERSPD", "CAM_APERTURE", "CAM_ISO", "CAM_WBMODE", "CAM_FOCUSMODE")
            return {name: (await told.read(name)).value for name in names}

        assert isinstance(camera, PreparesForPhotos)
        assert isinstance(camera, MetersExposure)
        before = await values()
        assert before["CAM_EXPMODE"] == 0
        assert await camera.prepare() == ""
        assert not camera.needs_metering
        assert await values() == pytest.approx(
            {"CAM_EXPMODE": 1, "CAM_SHUTTERSPD": 0.002, "CAM_APERTURE": 8, "CAM_ISO": 200}
            | {"CAM_WBMODE": 4, "CAM_FOCUSMODE": 1}
        )
        assert await camera.prepare() == "", "a mission that goes on makes them again"
        await camera.restore()
        assert await values() == before


@pytest.mark.parametrize(
    ("uri", "why"),
    [
        ("", "it tells no camera definition"),
        ("http://198.51.100.7/camera.xml", "host '198.51.100.7' is not in [camera] file_hosts"),
        ("file:///etc/passwd", "neither http nor MAVLink FTP"),
        ("{base}/none.xml", "HTTP 404"),
        ("{base}/page.htm", "its root is <html>"),
        ("{base}/large.xml", "at most 1048576 are accepted"),
        ("{base}/other.xml", "does not let white balance be set"),
    ],
)
async def test_a_camera_without_settings_says_that_they_cannot_be_locked(
    monkeypatch: pytest.MonkeyPatch, uri: str, why: str
) -> None:
    # a file that is not there may come yet, so that it is asked for until the time is over
    limit_s = 2.0 if "none.xml" in uri else 60.0
    monkeypatch.setattr("panoexec.adapters.camera.settings.mavlink_settings.DEFINITION_S", limit_s)
    besides = {"page.htm": b"<html></html>", "large.xml": b" " * (1 << 21)}
    besides["other.xml"] = definition().replace(b"CAM_WBMODE", b"OTHER")
    with serving_photos(None, besides=besides) as base:
        peer = SettingsPeer(uri.format(base=base))
        async with camera_of(peer, BALANCE, hosts=("127.0.0.1",)) as camera:
            assert why in await camera.prepare()
            await camera.restore()
    assert peer.value == 0


async def test_a_shutter_of_the_autopilot_has_no_settings() -> None:
    peer = CameraPeer(component=1)
    peer.parameters |= {"CAM1_FEEDBAK_PIN": -1, "CAM1_INTRVAL_MIN": 0}
    async with camera_of(peer, BALANCE) as camera:
        assert "a shutter of the autopilot has no settings" in await camera.prepare()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extended_parameters, "_ANSWER_S", 1.2)


@pytest.mark.usefixtures("quick")
async def test_lost_and_slow_answers_are_waited_for_and_nothing_is_believed_without_reading_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with serving_photos(None, besides={"camera.xml": definition()}) as base:
        peer = SettingsPeer(f"{base}/camera.xml")
        async with camera_of(peer, BALANCE, hosts=("127.0.0.1",)) as camera:
            peer.mute, peer.results = 1, [None, 0]  # the first of each is lost
            assert await camera.prepare() == ""
            assert peer.value == 4
            await camera.restore()
            assert peer.value == 0
            peer.obeys = False
            assert "keeps white balance at Auto; Daylight was set" in await camera.prepare()
            peer.results = [1]
            with pytest.raises(DeviceError, match="does not take 4 for CAM_WBMODE: this value is not supported now"):
                await camera.prepare()
            monkeypatch.setattr(extended_parameters, "_ANSWER_S", 0.2)
            peer.mute = 100
            with pytest.raises(DeviceError, match="does not answer about CAM_WBMODE"):
                await camera.prepare()


@pytest.mark.usefixtures("quick")
async def test_settings_are_made_again_on_a_camera_that_restarted() -> None:
    with serving_photos(None, besides={"camera.xml": definition()}) as base:
        peer = SettingsPeer(f"{base}/camera.xml")
        async with camera_of(peer, BALANCE, hosts=("127.0.0.1",)) as camera:
            assert await camera.prepare() == ""
            peer.value = 0
            camera._restarted()
            for task in tuple(camera._lock._tasks):
                await task
            assert peer.value == 4


async def test_mavsdk_itself_asks_no_host_for_a_definition(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(file_server._Handler, "do_GET", lambda request: asked.append(request.path))
    with serving_photos(None) as base:
        peer = SettingsPeer(f"{base}/camera.xml")
        peer.name = f"Eye {os.getpid()}-{time.time_ns()}"  # MAVSDK keeps what it fetched, by the camera's name
        with no_downloads(os.environ):
            async with camera_of(peer, LockSection(), hosts=("127.0.0.1",)) as camera:
                await camera.discover()
                await asyncio.sleep(1.0)
    assert asked == []
    assert os.environ.get("http_proxy") != "http://127.0.0.1:9"
