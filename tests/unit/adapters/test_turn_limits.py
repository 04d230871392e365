"""What an autopilot's parameters say of turns, and how fast a vehicle is expected to turn then."""

from __future__ import annotations

import math

import pytest

from panoexec.adapters.turn_limits import read_turn_limits
from panoexec.inputs.plan_options import configured_turning
from panoexec.inputs.vehicle_sections import VehicleSection
from panoexec.planning.model import Turning, TurnLimits
from panoexec.planning.order.duration import turn_times_s

PX4 = {"MPC_YAWRAUTO_MAX": 60.0, "MPC_YAWRAUTO_ACC": 20.0}
ARDUPILOT = {"ATC_SLEW_YAW": 6000.0, "ATC_RATE_Y_MAX": 0.0, "ATC_ACCEL_Y_MAX": 27000.0}


class Parameters:
    def __init__(self, values: dict[str, float]) -> None:
        self._values = values

    async def parameter(self, name: str) -> float | None:
        return self._values.get(name)


async def test_px4_turns_at_its_own_rate() -> None:
    limits = await read_turn_limits(Parameters(PX4), "px4")
    assert limits == TurnLimits(rate_deg_s=60.0, acceleration_deg_s2=20.0, own_rate=True)


async def test_ardupilots_parameters_are_hundredths() -> None:
    limits = await read_turn_limits(Parameters(ARDUPILOT), "ardupilot")
    assert limits == TurnLimits(rate_deg_s=60.0, acceleration_deg_s2=270.0)
    slower = await read_turn_limits(Parameters(ARDUPILOT | {"ATC_RATE_Y_MAX": 30.0}), "ardupilot")
    assert slower.rate_deg_s == 30.0


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot", "other", None])
async def test_what_cannot_be_read_is_unknown(autopilot: str | None) -> None:
    limits = await read_turn_limits(Parameters({}), autopilot)
    assert (limits.rate_deg_s, limits.acceleration_deg_s2) == (math.inf, math.inf)
    assert configured_turning(VehicleSection(), limits) == Turning()


def test_without_a_configured_rate_the_vehicle_turns_as_its_autopilot_does() -> None:
    px4 = TurnLimits(rate_deg_s=60.0, acceleration_deg_s2=20.0, own_rate=True)
    assert configured_turning(VehicleSection(), px4) == Turning(rate_deg_s=60.0, acceleration_deg_s2=20.0)
    ardupilot = TurnLimits(rate_deg_s=60.0, acceleration_deg_s2=270.0)
    assert configured_turning(VehicleSection(), ardupilot) == Turning(rate_deg_s=45.0, acceleration_deg_s2=90.0)


def test_a_configured_rate_counts_as_far_as_the_autopilot_reaches_it() -> None:
    section = VehicleSection(yaw_rate_deg_s=30.0, yaw_acceleration_deg_s2=90.0)
    limits = TurnLimits(rate_deg_s=60.0, acceleration_deg_s2=20.0, own_rate=True)
    assert configured_turning(section, limits) == Turning(rate_deg_s=30.0, acceleration_deg_s2=20.0)


@pytest.mark.parametrize(("turn_deg", "took_s"), [(40, 3.5), (60, 3.5), (90, 4.5), (180, 6.5)])
def test_the_times_of_px4_are_those_that_were_measured(turn_deg: float, took_s: float) -> None:
    """SIH in calm air: from the command until the nose stays within 2°."""
    turning = Turning(rate_deg_s=60.0, acceleration_deg_s2=20.0, settle_s=0.0)
    assert 0 <= took_s - float(turn_times_s(turning, turn_deg)) <= 0.7
