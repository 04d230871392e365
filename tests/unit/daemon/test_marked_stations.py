"""Which items of a mission mark stations, how long its rest takes, and when a vehicle has arrived."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.autopilot_mission import MissionItem
from panoexec.daemon.stations.arrival import Arrival
from panoexec.daemon.stations.marked import LANDING_S, marked_stations, rest_of_mission_s
from panoexec.devices import VehicleStatus
from tests.repository import ROOT
from tests.unit.daemon.station_world import jump, marker, two_stations, waypoint

PRESETS = ["roof", "yard"]
NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


def test_a_held_waypoint_with_its_marker_is_a_station() -> None:
    stations, problems = marked_stations(two_stations(), PRESETS)
    assert [(one.waypoint, one.marker, one.preset, one.hold_s) for one in stations] == [
        (1, 2, "roof", 40),
        (3, 4, "yard", 40),
    ]
    assert problems == ()


@pytest.mark.parametrize(
    "item",
    [
        marker(2, 0),
        marker(2, 1, shoot=1),
        replace(marker(2, 1), params=(1.0, 0.0, 0.0, 0.0)),
        replace(marker(2, 1), params=(0.0, 0.0, 0.0, 1.0)),
        replace(marker(2, 1), z=3.0),
        replace(marker(2, 1), command=2000),
    ],
)
def test_an_ordinary_camera_item_marks_nothing(item: MissionItem) -> None:
    assert marked_stations([waypoint(0, 0), waypoint(1, 20, hold_s=40), item], PRESETS) == ((), ())


@pytest.mark.parametrize(
    ("items", "problem"),
    [
        ([waypoint(0, 0), waypoint(1, 20), marker(2, 1)], "waypoint 1: a station needs a hold time of at least 10 s"),
        ([waypoint(0, 0), waypoint(1, 20, hold_s=math.nan), marker(2, 1)], "waypoint 1: a station needs a hold time"),
        (
            [waypoint(0, 0), waypoint(1, 20, hold_s=30), marker(2, 3)],
            "waypoint 1: there is no preset 3, 2 are configured",
        ),
        ([waypoint(0, 0), marker(1, 1), marker(2, 1)], "item 2 marks no station: no waypoint is directly before it"),
        ([marker(0, 1)], "item 0 marks no station: no waypoint is directly before it"),
    ],
)
def test_a_marker_that_is_none_is_told(items: list[MissionItem], problem: str) -> None:
    stations, problems = marked_stations(items, PRESETS)
    assert not any(station.marker == items[-1].seq for station in stations)
    assert problems[-1].startswith(problem)


@given(
    st.lists(
        st.builds(
            MissionItem,
            seq=st.integers(0, 12),
            command=st.sampled_from([16, 19, 20, 21, 22, 177, 203, 206, 65535]),
            frame=st.integers(0, 255),
            params=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
            x=st.integers(-(2**31), 2**31 - 1),
            y=st.integers(-(2**31), 2**31 - 1),
            z=NUMBERS,
        ),
        max_size=12,
    )
)
def test_no_mission_is_too_odd(items: list[MissionItem]) -> None:
    stations, _ = marked_stations(items, PRESETS)
    for station in stations:
        assert station.preset in PRESETS
        assert station.hold_s >= 10
        assert rest_of_mission_s(items, after=station.marker, speed_m_s=5.0) >= 0


def test_the_rest_counts_legs_holds_jumps_and_the_way_home() -> None:
    home = replace(waypoint(6, 0), command=20, x=0, y=0)
    items = [*two_stations(), home]
    leg_s = (20 + 20 + 60) / 5
    rest_s = rest_of_mission_s(items, after=2, speed_m_s=5.0)
    assert rest_s == pytest.approx(leg_s + 40 + LANDING_S, rel=0.02)
    assert rest_of_mission_s(items, after=2, speed_m_s=5.0, unheld={3}) == pytest.approx(rest_s - 40)
    looped = [*two_stations(), jump(6, 3, 2), replace(home, seq=7)]
    assert rest_of_mission_s(looped, after=2, speed_m_s=5.0) == pytest.approx(rest_s + 2 * (20 + 20) / 5 + 80, rel=0.02)
    assert (
        rest_of_mission_s([waypoint(0, 0), replace(jump(1, 0, 1), params=(math.nan,) * 4)], after=0, speed_m_s=5) == 0
    )
    assert rest_of_mission_s([jump(0, 0, -1), jump(1, 0, 5)], after=0, speed_m_s=5.0) == 0


def test_a_jump_without_end_ends_the_estimate() -> None:
    items = [waypoint(0, 0), waypoint(1, 20), jump(2, 1, -1)]
    assert math.isfinite(rest_of_mission_s(items, after=1, speed_m_s=5.0))


def near(north_m: float, **changes: object) -> VehicleStatus:
    (station, _), _ = marked_stations(two_stations(), PRESETS)
    status = VehicleStatus(
        latitude_deg=station.latitude_deg + north_m / 111_320,
        longitude_deg=8.5,
        relative_altitude_m=20.0,
        position_ok=True,
    )
    return replace(status, **changes)  # type: ignore[arg-type]


def arrived(statuses: list[VehicleStatus], *, step_s: float = 0.2) -> list[bool]:
    (station, _), _ = marked_stations(two_stations(), PRESETS)
    arrival = Arrival()
    return [arrival.there(station, one, index * step_s, radius_m=2.0) for index, one in enumerate(statuses)]


def test_it_has_arrived_when_it_is_near_and_at_rest() -> None:
    assert arrived([near(0.3)] * 6) == [False] * 2 + [True] * 4
    assert not any(arrived([near(2.5)] * 20))


def test_it_has_not_arrived_while_it_passes() -> None:
    assert not any(arrived([near(-10 + metres) for metres in range(20)]))


def test_it_has_not_arrived_while_it_climbs_or_does_not_know_where_it_is() -> None:
    assert not any(arrived([near(0.2, relative_altitude_m=5.0 + 0.4 * index) for index in range(20)]))
    assert not any(arrived([near(0.2, position_ok=False)] * 20))
    assert not any(arrived([near(0.2, latitude_deg=math.nan)] * 20))


def test_the_plan_file_for_qgroundcontrol_has_two_stations() -> None:
    """Numbered as ArduPilot does, whose first item is home."""
    plan = json.loads((ROOT / "examples" / "stations.plan").read_text(encoding="utf-8"))
    items = [waypoint(0, 0)]
    for seq, entry in enumerate(plan["mission"]["items"], start=1):
        given = [0.0 if value is None else float(value) for value in entry["params"]]
        scale = 1e7 if entry["frame"] == 3 else 1.0
        items.append(
            MissionItem(
                seq=seq,
                command=entry["command"],
                frame=entry["frame"],
                params=(given[0], given[1], given[2], given[3]),
                x=round(given[4] * scale),
                y=round(given[5] * scale),
                z=given[6],
            )
        )
    stations, problems = marked_stations(items, PRESETS)
    assert [(one.waypoint, one.preset, one.hold_s) for one in stations] == [(2, "roof", 40), (4, "roof", 40)]
    assert problems == ()
