"""Who is on the link: which of them are vehicles, which is chosen, and whether that is certain."""

from __future__ import annotations

import pytest

from panoexec.adapters.link.roster import PRESENT_S, Roster
from panoexec.adapters.link.vehicle_identity import VehicleIdentity

QUAD, HEXA, TRACKER, STATION, COMPANION, CAMERA = 2, 13, 5, 6, 18, 30
ARDUPILOT, INVALID, PX4, GENERIC = 3, 8, 12, 0


class Link:
    """A roster with a clock of its own, and the identity of the vehicle that was chosen."""

    def __init__(self, *, pinned: int | None = None) -> None:
        self.now_s = 100.0
        self.roster = Roster()
        self.identity = VehicleIdentity(self.roster, pinned=pinned, monotonic=lambda: self.now_s)

    def beat(self, system: int, *, autopilot: int = ARDUPILOT, kind: int = QUAD, component: int = 1) -> None:
        self.roster.note(system, component, kind, autopilot, self.now_s)

    def choose(self) -> int | None:
        chosen = self.roster.choose(self.identity.pinned, self.now_s)
        self.identity.system = None if chosen is None else chosen.system
        return self.identity.system


@pytest.mark.parametrize(
    ("autopilot", "kind", "component"),
    [
        (INVALID, STATION, 190),
        (INVALID, COMPANION, 191),
        (INVALID, CAMERA, 100),
        (ARDUPILOT, TRACKER, 1),
        (INVALID, QUAD, 1),
        (ARDUPILOT, QUAD, 2),
        (ARDUPILOT, STATION, 1),
    ],
)
def test_what_is_no_vehicle_is_not_chosen(autopilot: int, kind: int, component: int) -> None:
    link = Link()
    link.beat(7, autopilot=autopilot, kind=kind, component=component)
    assert link.choose() is None
    assert "heartbeats of system 7 arrive, but none of a vehicle's autopilot" in link.identity.why_not_found
    link.beat(3)
    assert link.choose() == 3
    assert link.identity.problem == ""


@pytest.mark.parametrize("kind", [0, 1, QUAD, 4, HEXA, 14, 20, 35, 43])
def test_vehicles_of_every_type_are(kind: int) -> None:
    link = Link()
    link.beat(3, kind=kind, autopilot=PX4)
    assert link.choose() == 3
    assert link.identity.autopilot == "px4"


def test_the_first_one_is_chosen_and_several_are_told_with_what_to_set() -> None:
    link = Link()
    link.beat(9)
    link.now_s += 0.1
    link.beat(4)
    assert link.choose() == 9
    assert link.identity.label == "ArduPilot, system 9 (the first vehicle that was heard)"
    told = link.identity.problem
    assert "system 9, which was heard first, and system 4" in told
    assert "set [vehicle] system_id" in told
    assert link.identity.news() == told
    assert link.identity.news() == "", "once"
    link.now_s += PRESENT_S - 1
    link.beat(9)
    assert link.identity.problem == told
    link.now_s += 1.0
    assert link.identity.problem == "", "the other one is gone"


def test_a_pinned_vehicle_is_certain_whoever_beats_first() -> None:
    link = Link(pinned=4)
    link.beat(9)
    assert link.choose() is None
    assert link.identity.why_not_found == (
        "[vehicle] system_id is 4, but the vehicles on this link have the system ids 9"
    )
    link.beat(4, autopilot=PX4)
    assert link.choose() == 4
    assert link.identity.problem == ""
    assert link.identity.label == "PX4, system 4 (set by [vehicle] system_id)"
    assert [member.system for member in link.identity.others] == [9]


def test_the_chosen_one_falls_silent_while_another_beats() -> None:
    link = Link()
    link.beat(9)
    assert link.choose() == 9
    link.now_s += 600
    assert link.identity.problem == "", "nobody is there"
    link.beat(4)
    assert link.identity.problem == (
        "the vehicle of system 9 is silent, but the vehicle of system 4 sends heartbeats: if that is the right one, "
        "set [vehicle] system_id = 4 and restart"
    )
    link.beat(9)
    assert "several vehicles" in link.identity.problem


def test_other_components_and_other_programs_do_not_change_the_autopilot() -> None:
    link = Link()
    link.beat(1, autopilot=ARDUPILOT)
    assert link.choose() == 1
    for _ in range(20):
        link.now_s += 1.0
        link.beat(1, autopilot=PX4, component=191)
        link.beat(1, autopilot=PX4)
        link.beat(1, autopilot=ARDUPILOT)
        assert link.identity.autopilot == "ardupilot"
    assert "two autopilots of different kinds beat as system 1 component 1" in link.identity.problem
    assert "MAV_SYSID" in link.identity.problem
    for _ in range(20):
        link.now_s += 1.0
        link.beat(1, autopilot=ARDUPILOT)
    assert link.identity.problem == "", "the other one is gone"


def test_two_vehicle_types_with_one_id_are_two_vehicles() -> None:
    link = Link()
    link.beat(1)
    assert link.choose() == 1
    for _ in range(4):
        link.now_s += 1.0
        link.beat(1, kind=10)
        link.beat(1)
    assert link.identity.kind == QUAD
    assert link.identity.problem != ""


def test_an_autopilot_that_starts_up_may_change_and_a_replaced_one_is_believed_in_the_end() -> None:
    link = Link()
    link.beat(1, autopilot=PX4, kind=0)
    assert link.choose() == 1
    link.now_s += 1.0
    link.beat(1, autopilot=PX4, kind=HEXA)
    assert link.identity.kind == HEXA
    for _ in range(7):
        link.now_s += 1.0
        link.beat(1, autopilot=ARDUPILOT)
    assert link.identity.autopilot == "ardupilot"


def test_foreign_devices_are_known_by_their_type() -> None:
    link = Link()
    link.beat(4)
    link.beat(1, autopilot=INVALID, kind=CAMERA, component=100)
    link.beat(4, autopilot=INVALID, kind=CAMERA, component=101)
    (camera,) = link.roster.foreign(4, CAMERA, link.now_s)
    assert camera.ids == "system 1 component 100"
    assert link.roster.systems(link.now_s) == [1, 4]
