"""How fast an autopilot turns the vehicle, by its parameters.

Sources: ArduPilot 4.7 (`AutoYaw::set_fixed_yaw_rad`, `AC_AttitudeControl::get_slew_yaw_max_rads`) and PX4 1.17
(`FlightTaskAuto`); measured on PX4's SIH with the defaults of 60°/s and 20°/s²: 40° took 3.0 to 3.5 s until the nose
stayed within 2°, 90° took 4.5 s, 180° 6.5 s (the profile of these limits: 2.8, 4.2 and 6.0 s).
"""

from __future__ import annotations

import math
from typing import Final, Protocol

from panoexec.planning.model import TurnLimits

_CENTI: Final = 100.0


class ReadsParameters(Protocol):
    """The part of `MavsdkRequests` that is used here."""

    async def parameter(self, name: str) -> float | None:
        """See `MavsdkRequests.parameter`."""
        ...


async def read_turn_limits(requests: ReadsParameters, autopilot: str | None) -> TurnLimits:
    """The limits of turns on the spot; what cannot be read is unknown.

    ArduPilot turns at the commanded rate, up to `ATC_SLEW_YAW` (0.01°/s) and `ATC_RATE_Y_MAX` (°/s, 0 = none), and
    accelerates with `ATC_ACCEL_Y_MAX` (0.01°/s², 0 = at once). PX4 has its own rate `MPC_YAWRAUTO_MAX` (°/s) and
    acceleration `MPC_YAWRAUTO_ACC` (°/s²).

    Raises:
        LinkError: the autopilot has not been found yet.
    """
    if autopilot == "px4":
        rate, acceleration = await requests.parameter("MPC_YAWRAUTO_MAX"), await requests.parameter("MPC_YAWRAUTO_ACC")
        return TurnLimits(rate_deg_s=_limit(rate), acceleration_deg_s2=_limit(acceleration), own_rate=True)
    if autopilot != "ardupilot":
        return TurnLimits()
    slew, rate = await requests.parameter("ATC_SLEW_YAW"), await requests.parameter("ATC_RATE_Y_MAX")
    acceleration = await requests.parameter("ATC_ACCEL_Y_MAX")
    return TurnLimits(
        rate_deg_s=min(_limit(slew) / _CENTI, _limit(rate)), acceleration_deg_s2=_limit(acceleration) / _CENTI
    )


def _limit(value: float | None) -> float:
    return value if value is not None and value > 0 else math.inf
