"""ArduCopter in software: ArduPilot's SITL."""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from panoexec.dryrun.firmware import Launch, SitlOptions
from panoexec.planning.model import Turning
from panoexec.sim.config import SimConfig
from panoexec.sim.ports import free_udp_ports

BINARY_VARIABLE: Final = "ARDUPILOT_SITL"
"""Environment variable with the path of the binary."""

WHAT: Final = "the ArduCopter binary of an ArduPilot SITL build, build/sitl/bin/arducopter"
PARAMETER_FILE: Final = "ardupilot-sitl.parm"
SHUTTER_OUTPUT: Final = 9
"""The servo output of the camera trigger; the motors use the first ones."""
FULL_WIND_M: Final = 25
"""Height from which the wind has its full speed, metres."""


class ArduCopter:
    """See `Firmware`."""

    kind = "ardupilot"
    name = "ArduCopter"
    may_slow = True
    turning = Turning()

    def launch(self, folder: Path, options: SitlOptions) -> Launch:
        """See `Firmware.launch`."""
        return Launch(command=_command(options, defaults=_write_parameters(folder, options.parameters)))

    def parameters(self, simulation: SimConfig) -> dict[str, float]:
        """See `Firmware.parameters`."""
        return wind_parameters(simulation) | payload_parameters(simulation)


def wind_parameters(simulation: SimConfig) -> dict[str, float]:
    """SITL's wind parameters: gusts of an eighth of the mean speed, and less wind near the ground.

    With full wind down to the ground, an ArduCopter that tilts against it does not detect the landing (measured at
    8 m/s).
    """
    airframe = simulation.airframe
    return {
        "SIM_WIND_T": 0,  # proportional to the square root of the height, up to SIM_WIND_T_ALT
        "SIM_WIND_T_ALT": FULL_WIND_M,
        "SIM_WIND_SPD": airframe.wind_m_s,
        "SIM_WIND_DIR": airframe.wind_from_deg,
        "SIM_WIND_TURB": airframe.wind_m_s / 8,
    }


def payload_parameters(simulation: SimConfig) -> dict[str, float]:
    """Autopilot parameters for a payload that differs from the default.

    A pan range of 0 to 0 tells ArduPilot that the mount has two axes. A camera on a servo is triggered by an output of
    the autopilot, which is the only component to report it (CAMERA_FEEDBACK).
    """
    gimbal = simulation.gimbal
    parameters: dict[str, float] = {}
    if not gimbal.yaw_endless:
        parameters |= {"MNT1_YAW_MIN": gimbal.yaw.min_deg, "MNT1_YAW_MAX": gimbal.yaw.max_deg}
    if simulation.camera_kind == "servo":
        parameters |= {"CAM1_TYPE": 1.0, f"SERVO{SHUTTER_OUTPUT}_FUNCTION": 10.0}
        if simulation.camera.trigger_min_s:
            parameters["CAM1_INTRVAL_MIN"] = simulation.camera.trigger_min_s
    return parameters


def _write_parameters(folder: Path, parameters: Mapping[str, float]) -> str:
    """The parameter files, in order of increasing precedence."""
    shipped, added = folder / PARAMETER_FILE, folder / "run.parm"
    text = (importlib.resources.files("panoexec.dryrun") / PARAMETER_FILE).read_text(encoding="utf-8")
    shipped.write_text(text, encoding="utf-8")
    added.write_text("".join(f"{name} {value:g}\n" for name, value in parameters.items()), encoding="utf-8")
    return f"{shipped.name},{added.name}"


def _command(options: SitlOptions, *, defaults: str) -> tuple[str, ...]:
    rc_port, irlock_port = free_udp_ports(2)
    latitude_deg, longitude_deg, altitude_m, heading_deg = options.home
    return (
        str(options.binary),
        *("--model", "+"),
        "--wipe",
        *("--speedup", f"{options.speedup:g}"),
        *("--home", f"{latitude_deg:.7f},{longitude_deg:.7f},{altitude_m:.2f},{heading_deg:.1f}"),
        *("--defaults", defaults),
        *("--serial0", f"udpclient:127.0.0.1:{options.ground_port}"),
        *("--serial1", f"udpclient:127.0.0.1:{options.payload_port}"),
        *("--serial2", "none" if options.station_port is None else f"udpclient:127.0.0.1:{options.station_port}"),
        # it binds these ports whether they are used or not
        *("--rc-in-port", str(rc_port)),
        *("--irlock-port", str(irlock_port)),
    )
