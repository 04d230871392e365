"""Devices of a dry-run: starts the vehicle, connects, discovers gimbal and camera, takes off if needed."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path

from panoexec.adapters.camera.open_camera import open_camera
from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.file_urls import FileUrls
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.stream_health import DEFAULT_STREAMS, Stream
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import Clock, VehicleClock
from panoexec.dryrun.clock_follower import TIME_STREAM, ClockFollower
from panoexec.dryrun.lockstep import Lockstep
from panoexec.dryrun.pilot import MavsdkPilot
from panoexec.dryrun.rigs import Rig, VehicleUnderTest
from panoexec.errors import DeviceError
from panoexec.inputs.vehicle_sections import CameraSection, LockSection
from panoexec.mission.settings import MissionSettings
from panoexec.sim.config import SimConfig
from panoexec.store.session import Devices

FIND_S = 30.0
"""Timeout for discovering the simulated devices, seconds of real time."""

HOVER_M = 30.0
"""Hover height above ground for the panorama, metres."""


@asynccontextmanager
async def devices_on(
    vehicle_under_test: VehicleUnderTest,
    *,
    images: Path | None,
    clock: Clock,
    note: Callable[[str], None],
    lock: LockSection | None = None,
) -> AsyncIterator[tuple[Devices, Rig]]:
    """The devices of a running vehicle, discovered and streaming; airborne, if the rig is ours to fly.

    Settings of `lock` are made on the camera, and must not change within the panorama.

    The vehicle lands after the block, unless the block failed: then the simulation is just stopped.

    Raises:
        PanoexecError: starting, discovery or take-off failed.
    """
    async with AsyncExitStack() as stack:
        rig = await stack.enter_async_context(vehicle_under_test.running(images=images, note=note))
        files = FileUrls(folders=() if images is None else (images,))
        link = await stack.enter_async_context(
            MavsdkLink(
                rig.connection,
                clock=clock,
                vehicle_system_id=rig.system_id,
                streams=_streams(rig, clock),
                files=files,
            )
        )
        keeper = follower = None
        if isinstance(clock, VehicleClock) and rig.allow is not None:
            keeper = Lockstep(clock, rig.allow, speedup=vehicle_under_test.speedup)
            stack.enter_context(keeper.keeping(link))
        elif isinstance(clock, VehicleClock):
            follower = ClockFollower(clock)
            stack.enter_context(follower.following(link))
        gimbal = await stack.enter_async_context(MavsdkGimbal(link))
        locked = lock or LockSection()
        section = CameraSection(lock=locked)
        if rig.camera:
            section = CameraSection(trigger="gphoto2", port=rig.camera, lock=locked)
        camera = await stack.enter_async_context(open_camera(section, link))
        vehicle = await stack.enter_async_context(MavsdkVehicle(link))
        await link.wait_autopilot(FIND_S)
        found = await gimbal.discover(FIND_S)
        await camera.discover(FIND_S)
        rig.about["gimbal_feedback"] = found.feedback
        rig.about["autopilot_version"] = await _autopilot_version(link)
        devices = Devices(gimbal=gimbal, camera=camera, vehicle=vehicle)
        if keeper is not None:
            await keeper.begin()
        if not rig.must_fly:
            yield devices, rig
            return
        pilot = MavsdkPilot(link, vehicle, clock=clock, px4=rig.about.get("autopilot") == "px4")
        if follower is not None and rig.may_slow:
            follower.govern(vehicle_under_test.speedup, pilot.set_speed)
        note("waiting for GPS and estimator, then taking off")
        await pilot.take_off(HOVER_M)
        note(f"hovering at {HOVER_M:g} m")
        yield devices, rig
        note("landing")
        try:
            await pilot.land()
        except DeviceError as error:  # the panorama is complete: keep its summary
            note(str(error))
            rig.about["landed"] = False
        else:
            rig.about["landed"] = True
            note("landed and disarmed")


def lock_on(simulation: SimConfig, *, images: bool) -> LockSection:
    """What is locked on the simulated camera: all that it offers.

    Args:
        simulation: the vehicle.
        images: whether there are photos, one of which the exposure can be metered by.
    """
    if simulation.camera.definition == "none" or simulation.camera_kind != "mavlink":
        return LockSection()
    if images:
        return LockSection(exposure="first", white_balance="Daylight", focus="manual")
    return LockSection(
        exposure="manual", shutter_s=0.002, aperture=5.6, iso=100, white_balance="Daylight", focus="manual"
    )


def _streams(rig: Rig, clock: Clock) -> tuple[Stream, ...]:
    """The message streams to request, including the autopilot's time if the clock follows it."""
    follows = isinstance(clock, VehicleClock) and rig.allow is None
    return (*DEFAULT_STREAMS, TIME_STREAM) if follows else DEFAULT_STREAMS


async def _autopilot_version(link: MavsdkLink) -> str:
    """The firmware version from AUTOPILOT_VERSION (148), "" if unavailable."""
    try:
        fields = (await link.requests.message(148, "AUTOPILOT_VERSION")).fields
    except DeviceError:
        return ""
    word = int(fields["flight_sw_version"])
    major, minor, patch, kind = word >> 24 & 0xFF, word >> 16 & 0xFF, word >> 8 & 0xFF, word & 0xFF
    return f"{major}.{minor}.{patch}" + {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc"}.get(kind, "")


def settings_on(rig: Rig, devices: Devices, settings: MissionSettings, note: Callable[[str], None]) -> MissionSettings:
    """The settings for this vehicle: for one on the ground, the flight guards are disabled."""
    if not rig.may_stand or devices.vehicle.status.in_air:
        return settings
    note("the vehicle is on the ground and stays there: flight guards are disabled")
    guards = replace(settings.guards, position_hold=False, position_drift_m=math.inf, parallax_px=0.0, allowed_modes=())
    return replace(settings, guards=guards)
