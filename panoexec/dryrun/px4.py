"""PX4 in software: its SIH simulator (simulation in hardware) on POSIX, which needs no other program.

Facts are from PX4 1.17 alpha: `ROMFS/px4fmu_common/init.d-posix/rcS` looks `px4-rc.mavlink` up in PATH, where a
user's script may come first, and sets each environment variable `PX4_PARAM_<NAME>` as a parameter.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Final

from panoexec.dryrun.firmware import Launch, SitlOptions
from panoexec.errors import UsageError
from panoexec.planning.model import Turning
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_ports

BINARY_VARIABLE: Final = "PX4_SITL"
"""Environment variable with the path of the binary."""

WHAT: Final = "the px4 binary of a SITL build, build/px4_sitl_default/bin/px4"
_STARTUP: Final = Path("etc/init.d-posix/rcS")

PARAMETERS: Final[dict[str, float]] = {
    "MAV_SYS_ID": 1,  # otherwise taken from the instance number
    "MNT_MODE_IN": 4,  # MAVLink gimbal protocol v2
    "MNT_MODE_OUT": 2,  # a MAVLink gimbal; 0 and 1 only echo the set point
    "COM_RC_IN_MODE": 4,  # no transmitter
    "NAV_DLL_ACT": 0,  # no ground station is needed
    "COM_DISARM_PRFLT": 60,  # s on the ground before automatic disarming: time to command the take-off at any speed-up
    "SDLOG_MODE": -1,  # no flight log
    "MIS_TAKEOFF_ALT": 30,
}
"""Parameters that differ from the defaults."""


def is_px4(binary: Path) -> bool:
    """Whether a binary is PX4's: the start-up files that it needs are beside its folder in a build."""
    return (_root(binary) / _STARTUP).is_file()


def _root(binary: Path) -> Path:
    return binary.resolve().parent.parent


TURNING: Final = Turning(rate_deg_s=60.0, acceleration_deg_s2=20.0)
"""MPC_YAWRAUTO_MAX and MPC_YAWRAUTO_ACC, by default."""


class Px4:
    """See `Firmware`."""

    kind = "px4"
    name = "PX4"
    may_slow = False
    turning = TURNING

    def launch(self, folder: Path, options: SitlOptions) -> Launch:
        """See `Firmware.launch`."""
        scripts = folder / "scripts"
        scripts.mkdir()
        (scripts / "px4-rc.mavlink").write_text(_links(options), encoding="utf-8")
        latitude_deg, longitude_deg, altitude_m, _ = options.home
        environment = {
            "PATH": f"{scripts}{os.pathsep}{os.environ.get('PATH', os.defpath)}",
            "PX4_SIM_MODEL": "sihsim_quadx",
            "PX4_HOME_LAT": f"{latitude_deg:.7f}",
            "PX4_HOME_LON": f"{longitude_deg:.7f}",
            "PX4_HOME_ALT": f"{altitude_m:.2f}",
        } | {f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in (PARAMETERS | dict(options.parameters)).items()}
        if options.speedup != 1:
            environment["PX4_SIM_SPEED_FACTOR"] = f"{options.speedup:g}"
        # the instance names a lock file and a socket in /tmp: the port is as unique as these must be
        instance = str(options.ground_port)
        command = (str(options.binary), "-d", "-i", instance, "-w", str(folder), str(_root(options.binary) / "etc"))
        leaves = (Path(f"/tmp/px4_lock-{instance}"), Path(f"/tmp/px4-sock-{instance}"))  # noqa: S108  (PX4's choice)
        return Launch(command=command, environment=environment, leaves=leaves)

    def parameters(self, simulation: SimConfig) -> dict[str, float]:
        """See `Firmware.parameters`."""
        airframe, gimbal = simulation.airframe, simulation.gimbal
        if simulation.camera_kind == "servo":
            raise UsageError("--trigger servo: only available with ArduPilot; PX4's own trigger is not simulated")
        direction = math.radians(airframe.wind_from_deg)
        parameters = {
            "SIH_WIND_N": -airframe.wind_m_s * math.cos(direction),
            "SIH_WIND_E": -airframe.wind_m_s * math.sin(direction),
        }
        if not gimbal.yaw_endless:
            parameters |= {"MNT_RANGE_YAW": gimbal.yaw.max_deg - gimbal.yaw.min_deg}
        return parameters


def _links(options: SitlOptions) -> str:
    """The MAVLink instances: one for the mission, one for the gimbal and the camera, both forwarding."""
    ground, payload, station = free_udp_ports(3)
    other = f"mavlink start -x -u {station} -r 400000 -f -m onboard -o {options.station_port}\n"
    return (
        f"mavlink start -x -u {ground} -r 4000000 -f -m onboard -o {options.ground_port}\n"
        f"mavlink start -x -u {payload} -r 400000 -f -m gimbal -o {options.payload_port}\n"
        # the payload's time follows the stamps of this message
        f"mavlink stream -r 50 -s AUTOPILOT_STATE_FOR_GIMBAL_DEVICE -u {payload}\n"
        + (other if options.station_port is not None else "")
    )
