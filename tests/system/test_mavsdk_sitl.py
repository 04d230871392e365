"""The adapters on ArduCopter's own software. Opt in: ARDUPILOT_SITL=/path/to/build/sitl/bin/arducopter pytest …

Once with the simulated payload attached (a MAVLink gimbal, type 6, and a MAVLink camera), once with what ArduPilot
drives itself (a servo mount, type 1, and a camera on a servo, type 1).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from panoexec.adapters.camera.mavsdk_camera import MavsdkCamera
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.file_urls import FileUrls
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import SystemClock
from panoexec.devices import EvidenceLevel
from panoexec.dryrun.arducopter import BINARY_VARIABLE
from panoexec.dryrun.autopilot import running_sitl, sitl_binary
from panoexec.dryrun.firmware import SitlOptions
from panoexec.dryrun.pilot import MavsdkPilot
from panoexec.dryrun.rigs import SitlVehicle
from panoexec.mission.pointing.poses import read_pose
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_ports
from tests.waiting import eventually

SPEEDUP = 4.0
HOME = (-35.363261, 149.165230, 584.0, 353.0)
SERVO_RIG = {
    "MNT1_TYPE": 1,
    "SERVO9_FUNCTION": 6,
    "SERVO10_FUNCTION": 7,
    "SERVO11_FUNCTION": 8,
    "CAM1_TYPE": 1,
    "SERVO12_FUNCTION": 10,
}
REBOOT = 246

pytestmark = pytest.mark.skipif(
    not os.environ.get(BINARY_VARIABLE), reason=f"set {BINARY_VARIABLE} to an ArduCopter SITL binary to run it"
)


@dataclass
class MissionContext:
    link: MavsdkLink
    gimbal: MavsdkGimbal
    camera: MavsdkCamera
    vehicle: MavsdkVehicle
    pilot: MavsdkPilot
    clock: SystemClock

    async def boresight_error_deg(self, pitch_deg: float, yaw_deg: float, *, after_s: float) -> float:
        """How far the camera looks from where it was pointed at, some time after."""
        await self.gimbal.point(pitch_deg, yaw_deg)
        await self.clock.sleep(after_s)
        sample = await self.gimbal.feed.newer_than(self.clock.monotonic())
        rotation = read_pose(sample, self.gimbal.feed.vehicle_attitude_at(sample), 0.0).rotation
        assert rotation is not None
        return float(pose_error(pitch_deg, yaw_deg, rotation).boresight_deg)


@contextlib.asynccontextmanager
async def flight(connection: str, *folders: Path) -> AsyncIterator[MissionContext]:
    clock = SystemClock(SPEEDUP)
    async with (
        MavsdkLink(connection, clock=clock, files=FileUrls(folders=folders)) as link,
        MavsdkGimbal(link) as gimbal,
        MavsdkCamera(link) as camera,
        MavsdkVehicle(link) as vehicle,
    ):
        await link.wait_autopilot(30)
        pilot = MavsdkPilot(link, vehicle, clock=clock)
        await gimbal.discover(30)
        await camera.discover(30)
        await pilot.take_off(30.0)
        yield MissionContext(link, gimbal, camera, vehicle, pilot, clock)
        await pilot.land()
        assert not vehicle.status.armed


async def check_reboot(flown: MissionContext) -> None:
    """On the ground: the autopilot forgets its intervals, and is asked again without anybody's help."""
    assert await flown.link.requests.command(REBOOT, [1]) == 0
    await eventually(lambda: flown.vehicle.status.boot_count == 1, 60)
    async with asyncio.timeout(60):
        await flown.gimbal.feed.newer_than(flown.clock.monotonic() + 5.0)


async def test_a_mavlink_gimbal_and_camera_behind_a_real_autopilot(tmp_path: Path) -> None:
    rig = SitlVehicle(binary=sitl_binary(None), simulation=SimConfig(speedup=SPEEDUP))
    async with (
        rig.running(images=tmp_path, note=lambda _: None) as running,
        flight(running.connection, tmp_path) as flown,
    ):
        assert flown.gimbal.found is not None
        assert flown.gimbal.found.feedback == "vehicle"
        assert flown.vehicle.status.mode == "OFFBOARD"
        await flown.gimbal.acquire()
        assert flown.gimbal.in_control
        for index, (pitch_deg, yaw_deg) in enumerate(((-30.0, 40.0), (-90.0, 10.0), (0.0, -120.0)), start=1):
            assert await flown.boresight_error_deg(pitch_deg, yaw_deg, after_s=6.0) < 0.3
            capture = await flown.camera.trigger()
            found = await capture.evidence(EvidenceLevel.FILE_SEEN, 120.0)
            assert (found.level, found.image_index) == (EvidenceLevel.FILE_SEEN, index)
        assert flown.camera.surplus_photos == 0
        # the gimbal's own reports arrive, so the autopilot is throttled its copy of them
        assert flown.link.streams.throttled[285] == 1.0
        await flown.gimbal.release()
        assert not flown.gimbal.in_control
        await flown.pilot.land()
        await check_reboot(flown)


async def test_a_servo_mount_and_a_servo_camera_on_a_real_autopilot() -> None:
    (port, payload_port) = free_udp_ports(2)
    options = SitlOptions(
        binary=sitl_binary(None),
        ground_port=port,
        payload_port=payload_port,
        speedup=SPEEDUP,
        home=HOME,
        parameters=SERVO_RIG,
    )
    async with running_sitl(options), flight(f"udpin://127.0.0.1:{port}") as flown:
        assert flown.gimbal.found is not None
        assert flown.gimbal.found.feedback == "none", "nobody measures where servos are"
        assert flown.camera.found is not None
        assert flown.camera.found.by_autopilot
        await flown.gimbal.acquire()
        await flown.gimbal.point(0.0, -120.0)
        for expected in (1, 2):
            capture = await flown.camera.trigger()
            found = await capture.evidence(EvidenceLevel.COUNTED, 5.0)
            assert (found.level, found.image_index) == (EvidenceLevel.COUNTED, expected)
            await flown.clock.sleep(1.5)
        assert flown.camera.surplus_photos == 0
        await flown.gimbal.release()
