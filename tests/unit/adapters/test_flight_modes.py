"""Flight modes by MAVSDK's names, from the numbers of the autopilots."""

from __future__ import annotations

import pytest
from mavsdk.plugins.telemetry import FlightMode

from panoexec.adapters.flight_modes import flight_mode, own_name
from panoexec.adapters.link.roster import AutopilotKind
from panoexec.devices import VehicleStatus

QUAD, PLANE, ROVER = 2, 1, 10
CUSTOM = 1


@pytest.mark.parametrize(
    ("kind", "custom", "name"),
    [
        (QUAD, 4, "OFFBOARD"),
        (QUAD, 5, "HOLD"),
        (QUAD, 16, "POSCTL"),
        (QUAD, 0, "STABILIZED"),
        (QUAD, 9, "LAND"),
        (QUAD, 17, "UNKNOWN"),
        (PLANE, 12, "HOLD"),
        (ROVER, 4, "HOLD"),
        (ROVER, 15, "OFFBOARD"),
    ],
)
def test_ardupilot(kind: int, custom: int, name: str) -> None:
    assert flight_mode("ardupilot", kind, CUSTOM, custom) == name


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [(4, 3, "HOLD"), (4, 5, "RETURN_TO_LAUNCH"), (4, 99, "UNKNOWN"), (6, 0, "OFFBOARD"), (3, 0, "POSCTL")],
)
def test_px4(main: int, sub: int, name: str) -> None:
    assert flight_mode("px4", QUAD, CUSTOM, main << 16 | sub << 24) == name


def test_a_heartbeat_without_a_custom_mode_tells_none() -> None:
    assert flight_mode("ardupilot", QUAD, 128, 4) is None


def test_the_names_are_those_of_mavsdk() -> None:
    kinds = [("ardupilot", kind) for kind in (QUAD, PLANE, ROVER)] + [("px4", QUAD)]
    numbers = [*range(40), *(main << 16 | sub << 24 for main in range(10) for sub in range(10))]
    names = {flight_mode(autopilot, kind, CUSTOM, number) for autopilot, kind in kinds for number in numbers}  # type: ignore[arg-type]
    assert {"HOLD", "OFFBOARD", "POSCTL", "LAND"} < names
    assert names <= {mode.name for mode in FlightMode}


@pytest.mark.parametrize(
    ("autopilot", "kind", "custom_mode", "mode", "name"),
    [
        ("ardupilot", 2, 4, "OFFBOARD", "GUIDED"),
        ("ardupilot", 2, 6, "RETURN_TO_LAUNCH", "RTL"),
        ("ardupilot", 13, 17, "UNKNOWN", "BRAKE"),
        ("ardupilot", 2, 28, "UNKNOWN", "TURTLE"),
        ("ardupilot", 2, 8, "UNKNOWN", ""),
        ("ardupilot", 1, 4, "ACRO", ""),
        ("px4", 2, 5 << 24 | 4 << 16, "RETURN_TO_LAUNCH", "Return"),
        ("px4", 2, 6 << 16, "OFFBOARD", "Offboard"),
    ],
)
def test_the_name_that_the_pilot_knows(
    autopilot: AutopilotKind, kind: int, custom_mode: int, mode: str, name: str
) -> None:
    assert own_name(autopilot, kind, custom_mode, mode) == name


@pytest.mark.parametrize(
    ("mode", "own", "text"),
    [
        ("OFFBOARD", "GUIDED", "GUIDED (OFFBOARD)"),
        ("OFFBOARD", "Offboard", "Offboard"),
        ("HOLD", "", "HOLD"),
        ("UNKNOWN", "BRAKE", "BRAKE"),
        ("", "", "unknown"),
    ],
)
def test_a_mode_for_people(mode: str, own: str, text: str) -> None:
    assert VehicleStatus(mode=mode, own_mode=own).mode_text == text
