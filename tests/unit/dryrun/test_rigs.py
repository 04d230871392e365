"""Vehicles for dry-runs: rejected settings, and shutdown when a part fails."""

import asyncio
import os
import signal
import stat
import sys
from pathlib import Path

import pytest

from panoexec.dryrun.arducopter import payload_parameters, wind_parameters
from panoexec.dryrun.rigs import ConnectedVehicle, EmbeddedVehicle, SitlVehicle
from panoexec.errors import DeviceError, UsageError
from panoexec.sim.config import AirframeConfig, AxisConfig, GimbalConfig, SimConfig
from panoexec.sim.faults import AUTOPILOT_FAULTS, parse_fault

NOWHERE = Path("/nowhere/arducopter")


def silent(text: str) -> None:
    del text


@pytest.mark.parametrize("name", sorted(AUTOPILOT_FAULTS))
def test_faults_of_the_embedded_autopilot_are_rejected_for_a_real_one(name: str) -> None:
    simulation = SimConfig(faults=(parse_fault(name),), attach_url="tcp:127.0.0.1:1")
    with pytest.raises(UsageError, match=rf"--fault {name}: .*--sitl"):
        SitlVehicle(binary=NOWHERE, simulation=simulation)
    with pytest.raises(UsageError, match=rf"--fault {name}: .*--sitl-connect"):
        ConnectedVehicle(connection="udpin://0.0.0.0:1", simulation=simulation)
    EmbeddedVehicle(simulation=simulation)


@pytest.mark.parametrize(
    ("simulation", "named"),
    [
        (SimConfig(autopilot="px4"), "--autopilot px4"),
        (SimConfig(mount="servo"), "--mount"),
        (SimConfig(camera_kind="servo", faults=(parse_fault("photo-lost"),)), "reports the photos"),
    ],
)
def test_settings_that_a_real_autopilot_lacks_are_rejected(simulation: SimConfig, named: str) -> None:
    with pytest.raises(UsageError, match=named):
        SitlVehicle(binary=NOWHERE, simulation=simulation)


def test_a_connected_vehicle_without_our_payload_has_no_faults() -> None:
    with pytest.raises(UsageError, match=r"--fault drift: .*--attach"):
        ConnectedVehicle(connection="udpin://0.0.0.0:1", simulation=SimConfig(faults=(parse_fault("drift"),)))


def test_the_wind_is_full_where_the_vehicle_hovers() -> None:
    told = wind_parameters(SimConfig(airframe=AirframeConfig(wind_m_s=8.0, wind_from_deg=135.0)))
    assert (told["SIM_WIND_SPD"], told["SIM_WIND_DIR"], told["SIM_WIND_TURB"]) == (8.0, 135.0, 1.0)
    assert told["SIM_WIND_T_ALT"] < 30


def test_parameters_for_a_two_axis_mount_and_a_servo_shutter() -> None:
    assert payload_parameters(SimConfig()) == {}
    axis = AxisConfig(rate_deg_s=90.0, acceleration_deg_s2=360.0, min_deg=0.0, max_deg=0.0)
    told = payload_parameters(SimConfig(gimbal=GimbalConfig(yaw=axis, yaw_endless=False), camera_kind="servo"))
    assert told == {"MNT1_YAW_MIN": 0.0, "MNT1_YAW_MAX": 0.0, "CAM1_TYPE": 1.0, "SERVO9_FUNCTION": 10.0}


def test_invalid_connection_is_rejected_before_anything_starts() -> None:
    with pytest.raises(UsageError, match="foo://bar"):
        ConnectedVehicle(connection="foo://bar", simulation=SimConfig())


async def test_a_connected_vehicle_starts_nothing_and_is_not_flown() -> None:
    vehicle = ConnectedVehicle(connection="udpin://0.0.0.0:14550", simulation=SimConfig(speedup=3.0))
    async with vehicle.running(images=None, note=silent) as rig:
        assert (rig.connection, rig.must_fly, rig.may_stand) == ("udpin://0.0.0.0:14550", False, True)
    assert vehicle.speedup == 3.0


async def test_payload_is_stopped_when_the_sitl_exits_early(tmp_path: Path) -> None:
    binary = tmp_path / "arducopter"
    binary.write_text(f"#!{sys.executable} -S\nprint('panic: wrong model'); raise SystemExit(1)\n", encoding="utf-8")
    binary.chmod(binary.stat().st_mode | stat.S_IXUSR)
    children = set(_children())
    with pytest.raises(DeviceError, match="panic: wrong model") as caught:
        async with SitlVehicle(binary=binary, simulation=SimConfig()).running(images=None, note=silent):
            await asyncio.sleep(30)
    assert caught.value.exit_code == 3
    assert set(_children()) == children


async def test_a_simulation_that_dies_ends_the_block() -> None:
    before = set(_children())

    async def fly() -> None:
        async with EmbeddedVehicle(simulation=SimConfig()).running(images=None, note=silent) as rig:
            assert rig.connection.startswith("udpin://127.0.0.1:")
            (pid,) = set(_children()) - before
            os.kill(pid, signal.SIGKILL)
            await asyncio.sleep(30)

    with pytest.raises(DeviceError, match="exited unexpectedly"):
        await fly()


async def test_error_inside_the_block_propagates_unchanged() -> None:
    vehicle, before = EmbeddedVehicle(simulation=SimConfig()), set(_children())
    with pytest.raises(ZeroDivisionError):
        async with vehicle.running(images=None, note=silent):
            raise ZeroDivisionError
    with pytest.raises(asyncio.CancelledError):
        async with vehicle.running(images=None, note=silent):
            raise asyncio.CancelledError
    assert set(_children()) == before


def _children() -> list[int]:
    """Processes started by this one that still run."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                state, parent = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[:2]
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(parent) == os.getpid() and state != "Z":
                found.append(int(folder.name))
    return found
