"""Which waypoints of an autopilot's mission are stations, and how long the rest of the mission takes. Pure.

A station is a waypoint with a hold time (MAV_CMD_NAV_WAYPOINT, param1) and directly behind it
MAV_CMD_DO_DIGICAM_CONTROL with everything 0 but its identity (param6), which is the number of a preset: neither
ArduPilot nor PX4 does anything about such an item.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

from panoexec.adapters.autopilot_mission import MissionItem
from panoexec.mission.guards import EARTH_RADIUS_M

NAV_WAYPOINT: Final = 16
NAV_LOITER_TIME: Final = 19
NAV_RETURN: Final = 20
NAV_LAND: Final = 21
NAV_TAKEOFF: Final = 22
DO_JUMP: Final = 177
DIGICAM_CONTROL: Final = 203
LEAST_HOLD_S: Final = 10.0
"""Less would be over before panoexec, after a crash, is back to prolong it."""
LANDING_S: Final = 30.0
_HAVE_PLACES: Final = frozenset({NAV_WAYPOINT, 17, 18, NAV_LOITER_TIME, NAV_LAND, NAV_TAKEOFF, 82})
_MOST_STEPS: Final = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Station:
    """A waypoint with a panorama.

    Attributes:
        waypoint: its number in the mission.
        marker: number of the item that marks it.
        preset: id of the preset.
        hold_s: the plan's hold time.
        latitude_deg, longitude_deg: of the waypoint.
    """

    waypoint: int
    marker: int
    preset: str
    hold_s: float
    latitude_deg: float
    longitude_deg: float


def marked_stations(
    items: Sequence[MissionItem], presets: Sequence[str]
) -> tuple[tuple[Station, ...], tuple[str, ...]]:
    """The stations of a mission, in its order, and what is wrong with other items that mark one.

    Args:
        items: of the mission.
        presets: ids, in the order of the configuration.
    """
    stations, problems = [], []
    known = {item.seq: item for item in items}
    for item in items:
        number = _preset_number(item)
        if number is None:
            continue
        before = known.get(item.seq - 1)
        where = f"item {item.seq}"
        if before is None or before.command != NAV_WAYPOINT or not _has_place(before):
            problems.append(f"{where} marks no station: no waypoint is directly before it")
            continue
        where = f"waypoint {before.seq}"
        hold_s = before.params[0]
        if not hold_s >= LEAST_HOLD_S:
            problems.append(f"{where}: a station needs a hold time of at least {LEAST_HOLD_S:g} s")
        elif number > len(presets):
            problems.append(f"{where}: there is no preset {number}, {len(presets)} are configured")
        else:
            stations.append(
                Station(
                    waypoint=before.seq,
                    marker=item.seq,
                    preset=presets[number - 1],
                    hold_s=hold_s,
                    latitude_deg=before.x / 1e7,
                    longitude_deg=before.y / 1e7,
                )
            )
    return tuple(stations), tuple(problems)


def _preset_number(item: MissionItem) -> int | None:
    """The number of the preset that an item asks for; None if it marks no station."""
    if item.command != DIGICAM_CONTROL or item.y < 1 or item.x != 0:
        return None
    return item.y if all(math.isnan(value) or value == 0 for value in (*item.params, item.z)) else None


def _has_place(item: MissionItem) -> bool:
    return item.command in _HAVE_PLACES and not (item.x == 0 and item.y == 0)


def distance_to_m(latitude_deg: float, longitude_deg: float, to: tuple[float, float]) -> float:
    """Horizontal distance, metres, on a flat earth; NaN if one is unknown."""
    north = math.radians(to[0] - latitude_deg) * EARTH_RADIUS_M
    east = math.radians(to[1] - longitude_deg) * EARTH_RADIUS_M * math.cos(math.radians(latitude_deg))
    return math.hypot(north, east)


def rest_of_mission_s(
    items: Sequence[MissionItem],
    *,
    after: int,
    speed_m_s: float,
    unheld: Collection[int] = (),
) -> float:
    """How long the mission takes from an item on: legs, holds, the way home and landing; jumps included.

    Args:
        items: of the mission.
        after: number of the item from which the vehicle goes on.
        speed_m_s: between waypoints.
        unheld: numbers of waypoints whose hold times are not counted.
    """
    known = {item.seq: item for item in items}
    places = [item for item in items if _has_place(item)]
    start = next((item for item in reversed(places) if item.seq <= after), None)
    if start is None:
        return 0.0
    home = places[0]
    total_s, here, seq = 0.0, start, after + 1
    jumps: dict[int, int] = {}
    for _ in range(_MOST_STEPS):
        item = known.get(seq)
        if item is None:
            break
        seq += 1
        if item.command == DO_JUMP:
            target, times = item.params[:2]
            if not math.isfinite(target):
                continue
            if times < 0 or jumps.get(item.seq, 0) < times:
                jumps[item.seq] = jumps.get(item.seq, 0) + 1
                seq = int(target)
            continue
        if item.command in (NAV_RETURN, NAV_LAND):
            goal = home if item.command == NAV_RETURN or not _has_place(item) else item
            return total_s + _leg_s(here, goal, speed_m_s) + LANDING_S
        if _has_place(item):
            total_s += _leg_s(here, item, speed_m_s)
            here = item
            hold_s = item.params[0] if item.command in (NAV_WAYPOINT, NAV_LOITER_TIME) else 0.0
            total_s += hold_s if math.isfinite(hold_s) and item.seq not in unheld else 0.0
    return total_s


def _leg_s(here: MissionItem, there: MissionItem, speed_m_s: float) -> float:
    way = distance_to_m(here.x / 1e7, here.y / 1e7, (there.x / 1e7, there.y / 1e7))
    return way / speed_m_s
