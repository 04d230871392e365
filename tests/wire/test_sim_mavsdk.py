"""The simulated vehicle as seen by MAVSDK, in a separate process over UDP, without panoexec's adapters."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import itertools
import json
import math
from collections.abc import AsyncIterator
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.camera import CameraAsync
from mavsdk.asyncio.plugins.gimbal import ControlMode, GimbalAsync, GimbalMode, SendMode
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import SimulatorProcess, running_simulator

SPEEDUP = 10.0
"""Discovery alone takes 5 s of the vehicle's time."""


@dataclasses.dataclass(slots=True)
class Ground:
    """What a program on MAVSDK has of a vehicle."""

    system: Any
    gimbal: GimbalAsync
    camera: CameraAsync
    direct: MavlinkDirectAsync

    async def command(self, command_id: int, *params: float) -> int:
        """Send COMMAND_LONG to the autopilot; MAV_RESULT."""
        fields: dict[str, float] = {"target_system": 1, "target_component": 1, "command": command_id, "confirmation": 0}
        fields |= {f"param{i + 1}": params[i] if i < len(params) else 0.0 for i in range(7)}
        ack = await self.direct.send_command(MavlinkMessage("COMMAND_LONG", 1, 195, 1, 1, json.dumps(fields)))
        return int(json.loads(ack.fields_json)["result"])

    async def stream(self, *message_ids: int) -> None:
        """Ask for messages at 50 Hz."""
        for message_id in message_ids:
            assert await self.command(511, message_id, 20_000) == 0

    async def first_gimbal(self) -> Any:
        """Wait until MAVSDK lists a gimbal."""
        async with contextlib.aclosing(self.gimbal.subscribe_gimbal_list()) as lists:
            async for listed in lists:
                if listed.gimbals:
                    return listed.gimbals[0]
        raise AssertionError

    async def in_control(self) -> tuple[int, int]:
        """System and component in primary control, as of the next status."""
        async with contextlib.aclosing(self.gimbal.subscribe_control_status()) as statuses:
            async for status in statuses:
                return status.sysid_primary_control, status.compid_primary_control
        raise AssertionError


@contextlib.asynccontextmanager
async def flying(config: SimConfig) -> AsyncIterator[tuple[SimulatorProcess, Ground]]:
    """A simulated vehicle and MAVSDK connected to it."""
    config = dataclasses.replace(config, port=free_udp_port(), speedup=SPEEDUP)
    configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
    async with running_simulator(config) as simulator, Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(simulator.ready["connect"])
        system = await mavsdk.first_autopilot(timeout_s=60)
        assert system is not None
        yield simulator, Ground(system, GimbalAsync(system), CameraAsync(system), MavlinkDirectAsync(system))


async def test_discovery_control_pointing_attitude_and_photo(tmp_path: Path) -> None:
    async with asyncio.timeout(240), flying(SimConfig(output=tmp_path)) as (simulator, ground):
        await ground.stream(285, 30, 281)
        item = await ground.first_gimbal()
        # as measured on ArduPilot: no names, manager component 1, device 1
        assert (item.vendor_name, item.model_name) == ("", "")
        assert (item.gimbal_manager_component_id, item.gimbal_device_id) == (1, 1)
        await ground.gimbal.take_control(item.gimbal_id, ControlMode.PRIMARY)
        while await ground.in_control() != (1, 195):
            pass
        await ground.gimbal.set_angles(item.gimbal_id, 0, -35, 120, GimbalMode.YAW_LOCK, SendMode.ONCE)

        stamps, reached = [], False
        async with contextlib.aclosing(ground.gimbal.subscribe_attitude()) as attitudes:
            async for attitude in attitudes:
                stamps.append(attitude.timestamp_us)
                angles = attitude.euler_angle_north
                reached = reached or math.hypot(angles.pitch_deg + 35, angles.yaw_deg - 120) < 0.2
                if reached and len(stamps) > 200:
                    break
        # 50 a second; MAVSDK drops some while nobody takes them
        gaps_ms = [round((later - earlier) / 1000) for earlier, later in itertools.pairwise(stamps)]
        assert median(gaps_ms) == 20
        assert all(gap > 0 and gap % 20 == 0 for gap in gaps_ms)

        async with contextlib.aclosing(ground.camera.subscribe_capture_info()) as infos:
            coming = asyncio.ensure_future(anext(infos))
            await asyncio.sleep(0)
            await ground.camera.take_photo(100)
            info = await coming
        assert info.is_success
        assert (info.component_id, info.index) == (100, 1)
        assert info.file_url == (tmp_path / "IMG_00001.jpg").as_uri()
        assert info.attitude_euler_angle.pitch_deg == pytest.approx(-35, abs=0.2)
        assert info.attitude_euler_angle.yaw_deg == pytest.approx(120, abs=0.2)

        await ground.gimbal.release_control(item.gimbal_id)
        while await ground.in_control() != (0, 0):
            pass
    assert simulator.summary["photos"] == simulator.summary["written"] == 1
    assert (tmp_path / "IMG_00001.jpg").stat().st_size > 10_000


async def test_the_camera_as_mavsdk_lists_it() -> None:
    async with asyncio.timeout(240), flying(SimConfig()) as (_, ground):
        async with contextlib.aclosing(ground.camera.subscribe_camera_list()) as lists:
            async for listed in lists:
                if listed.cameras:
                    break
        (camera,) = listed.cameras
        optics = SimConfig().camera.optics
        assert (camera.component_id, camera.model_name) == (100, optics.name)
        assert camera.focal_length_mm == pytest.approx(optics.focal_length_mm)
        assert camera.horizontal_resolution_px == optics.image_width_px


async def test_servo_camera_is_reported_by_camera_feedback_only() -> None:
    async with asyncio.timeout(240), flying(SimConfig(camera_kind="servo", mount="servo")) as (_, ground):
        await ground.stream(285, 30)
        await ground.first_gimbal()
        async with contextlib.aclosing(ground.direct.subscribe_message("CAMERA_FEEDBACK")) as messages:
            coming = asyncio.ensure_future(anext(messages))
            await asyncio.sleep(0)
            await ground.camera.take_photo(1)
            fields = json.loads((await coming).fields_json)
        assert fields["img_idx"] == 1


@pytest.mark.parametrize(("autopilot", "mode", "device"), [("ardupilot", "OFFBOARD", 1), ("px4", "HOLD", 154)])
async def test_mavsdk_reports_both_autopilots_ready_to_fly(autopilot: Any, mode: str, device: int) -> None:
    async with asyncio.timeout(240), flying(SimConfig(autopilot=autopilot)) as (_, ground):
        await ground.stream(285, 1, 33, 245, 242, 24)
        telemetry = TelemetryAsync(ground.system)
        async with contextlib.aclosing(telemetry.subscribe_health()) as healths:
            async for health in healths:
                if health.is_global_position_ok and health.is_home_position_ok and health.is_armable:
                    break
        async with contextlib.aclosing(telemetry.subscribe_flight_mode()) as modes:
            async for flight_mode in modes:
                if flight_mode.name == mode:
                    break
        async with contextlib.aclosing(telemetry.subscribe_in_air()) as states:
            async for in_air in states:
                if in_air:
                    break
        item = await ground.first_gimbal()
        assert item.gimbal_device_id == device
        if autopilot == "px4":
            assert (item.vendor_name, item.model_name) == ("panoexec", "simulated gimbal")
