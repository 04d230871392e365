"""Why no panorama is flown at a station that the vehicle has reached. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from panoexec.adapters.autopilot_mission import MissionItem
from panoexec.daemon.stations.marked import Station, rest_of_mission_s
from panoexec.devices import VehicleStatus
from panoexec.errors import PanoexecError
from panoexec.inputs.config import Config
from panoexec.planning.model import Plan

_OVERHEAD_S = 5.0
_RETAKES = 1.25
"""A panorama takes so much longer than estimated, with photos that are taken again, and a little beside it."""


def refusal(
    config: Config,
    status: VehicleStatus,
    station: Station,
    *,
    plan: Plan | PanoexecError | None,
    items: Sequence[MissionItem],
    others: Collection[int],
    extends_hold: bool,
) -> str:
    """Why no panorama is flown; "" if one is.

    Args:
        config: of the daemon.
        status: of the vehicle.
        station: that it is at.
        plan: of the station's preset; None if it is not known yet.
        items: of the autopilot's mission.
        others: numbers of the waypoints that are stations: their hold times are not counted.
        extends_hold: whether hold times can be prolonged.
    """
    if isinstance(plan, PanoexecError):
        return f"preset {station.preset}: {plan}"
    if config.gimbal.yaw == "vehicle" and not config.stations.guided:
        return "the vehicle must turn, which is not done in its mission ([stations] guided)"
    if not status.position_ok:
        return "the position is not reliable"
    if plan is None or plan.estimate is None:
        return ""
    duration_s = plan.estimate.duration_s
    if not extends_hold and not config.stations.guided and _RETAKES * duration_s + _OVERHEAD_S > station.hold_s:
        return f"the hold time of {station.hold_s:.0f} s is too short for {duration_s:.0f} s of shooting"
    return _battery(config, status, station, duration_s=duration_s, items=items, others=others)


def _battery(
    config: Config,
    status: VehicleStatus,
    station: Station,
    *,
    duration_s: float,
    items: Sequence[MissionItem],
    others: Collection[int],
) -> str:
    """The battery must suffice for the panorama and the way home, without other panoramas, which can be skipped too."""
    hover_s, charge, floor = 60 * config.guards.hover_min, status.battery_frac, config.guards.battery_floor_frac
    if hover_s <= 0 or math.isnan(charge):
        return ""
    rest_s = rest_of_mission_s(items, after=station.marker, speed_m_s=config.stations.speed_m_s, unheld=others)
    need = (duration_s + rest_s) / hover_s
    if need <= charge - floor:
        return ""
    return (
        f"battery at {100 * charge:.0f} %: panorama and rest of the mission need {100 * need:.0f} % above the floor"
        f" of {100 * floor:.0f} %"
    )
