"""The pilot of simulated flights, with a scripted autopilot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from panoexec.adapters.link.message_hub import MavMessage
from panoexec.devices import VehicleStatus
from panoexec.dryrun import pilot as mavsdk_pilot
from panoexec.dryrun.pilot import DO_SET_MODE, NAV_TAKEOFF, MavsdkPilot
from panoexec.errors import DeviceError

QUADROTOR, FIXED_WING = 2, 1


@dataclass
class Clock:
    """Time that passes only while somebody sleeps."""

    now_s: float = 0.0
    after: Callable[[], None] = lambda: None

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return self.now_s

    async def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.after()


@dataclass
class Autopilot:
    """The link to a vehicle, the requests on it, and the vehicle, as far as the pilot looks."""

    clock: Clock
    kind: int = QUADROTOR
    fix_from_s: float = 5.0
    arms_from_s: float = 20.0
    climbs: bool = True
    lands: bool = True
    still_from_s: float = 0.0
    result: int = 0
    status: VehicleStatus = field(default_factory=lambda: VehicleStatus(latitude_deg=47.0, relative_altitude_m=0.0))
    commands: list[int] = field(default_factory=list)
    handlers: list[Callable[[MavMessage], None]] = field(default_factory=list)
    goal_m: float = 0.0
    arm: str = "arm"
    land: str = "land"

    def __post_init__(self) -> None:
        self.clock.after = self.step

    @property
    def components(self) -> dict[int, tuple[int, float]]:
        return {1: (self.kind, 0.0)}

    @property
    def requests(self) -> Autopilot:
        return self

    def on(self, name: str, handler: Callable[[MavMessage], None]) -> Callable[[], None]:
        assert name == "STATUSTEXT"
        self.handlers.append(handler)
        return lambda: self.handlers.remove(handler)

    def plugin(self, kind: object) -> Autopilot:
        del kind
        return self

    async def message(self, message_id: int, name: str) -> MavMessage:
        fix = 3 if self.clock.now_s >= self.fix_from_s else 1
        return MavMessage(name, 1, {"fix_type": fix, "id": message_id}, self.clock.now_s)

    async def command(self, number: int, params: list[float]) -> int:
        self.commands.append(number)
        if number == NAV_TAKEOFF and self.climbs:
            self.goal_m = params[6]
        return self.result

    async def mavsdk_call(self, what: str, call: Any) -> None:
        if call == self.land:
            self.goal_m = 0.0 if self.lands else self.goal_m
        elif self.clock.now_s >= self.arms_from_s:
            self.status = replace(self.status, armed=True)
        else:
            for component, text in ((1, "Arm: Need Position Estimate"), (1, "EKF3 is well"), (154, "Arm: not mine")):
                for handler in self.handlers:
                    handler(MavMessage("STATUSTEXT", component, {"text": text}, self.clock.now_s))
            raise DeviceError(f"{what}: denied")

    def step(self) -> None:
        height_m = self.status.relative_altitude_m
        height_m += min(max(self.goal_m - height_m, -2.0), 2.0)
        moving = self.clock.now_s < self.still_from_s
        landed = self.goal_m == 0 and height_m == 0 and self.lands and NAV_TAKEOFF in self.commands
        self.status = replace(
            self.status,
            relative_altitude_m=height_m,
            armed=self.status.armed and not landed,
            latitude_deg=self.status.latitude_deg + (1e-5 if moving else 0.0),
        )


@pytest.fixture(autouse=True)
def no_real_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavsdk_pilot, "_LEAST_REAL_S", 0.0)
    monkeypatch.setattr(mavsdk_pilot, "_STILL_REAL_S", 0.0)


def flown(**changes: Any) -> tuple[MavsdkPilot, Autopilot]:
    clock = Clock()
    autopilot = Autopilot(clock=clock, **changes)
    link: Any = autopilot
    return MavsdkPilot(link, link, clock=clock), autopilot


async def test_it_waits_for_gps_and_estimator_and_climbs() -> None:
    pilot, autopilot = flown()
    await pilot.take_off(30.0)
    assert autopilot.commands == [DO_SET_MODE, NAV_TAKEOFF]
    assert autopilot.status.armed
    assert autopilot.status.relative_altitude_m >= 0.97 * 30.0
    assert autopilot.clock.now_s > autopilot.arms_from_s
    assert autopilot.handlers == []
    await pilot.land()
    assert not autopilot.status.armed


async def test_take_off_waits_until_the_vehicle_holds_its_position() -> None:
    pilot, autopilot = flown(still_from_s=50.0)
    await pilot.take_off(30.0)
    assert autopilot.clock.now_s >= 50.0 + 3.0


async def test_take_off_ends_even_if_the_vehicle_never_holds_its_position() -> None:
    pilot, autopilot = flown(still_from_s=1e9)
    await pilot.take_off(30.0)
    assert autopilot.clock.now_s < 120.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": FIXED_WING}, r"not a multirotor \(MAV_TYPE 1\)"),
        ({"fix_from_s": 1e9}, r"no GPS fix within 180 s \(fix type 1, 3 is required\)"),
        ({"arms_from_s": 1e9}, r"could not be armed within 180 s: Arm: Need Position Estimate$"),
        ({"climbs": False}, r"climbing: not completed within 180 s"),
        ({"result": 4}, r"changing to GUIDED: failed"),
    ],
)
async def test_errors_name_what_prevents_the_flight(changes: dict[str, Any], words: str) -> None:
    pilot, autopilot = flown(**changes)
    with pytest.raises(DeviceError, match=words) as caught:
        await pilot.take_off(30.0)
    assert caught.value.exit_code == 3
    assert autopilot.handlers == []


async def test_landing_timeout_is_an_error() -> None:
    pilot, _ = flown(lands=False)
    await pilot.take_off(30.0)
    with pytest.raises(DeviceError, match="landing: not completed within 120 s"):
        await pilot.land()
