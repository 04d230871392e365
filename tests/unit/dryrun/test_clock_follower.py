"""A clock that follows an autopilot, and the control of its speed-up."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.clock import VehicleClock
from panoexec.dryrun.clock_follower import AUTOPILOT, WORK_S, ClockFollower, SpeedupController
from panoexec.errors import DeviceError


class Autopilot:
    """Tells its time."""

    def __init__(self) -> None:
        self._handler: Handler = lambda _: None

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        assert name == "SYSTEM_TIME"
        self._handler = handler
        return lambda: None

    def tell(self, boot_s: float, component: int = AUTOPILOT) -> None:
        self._handler(MavMessage("SYSTEM_TIME", component, {"time_boot_ms": round(boot_s * 1e3)}, 0.0))


async def test_mission_time_follows_the_autopilot_across_reboots() -> None:
    clock, autopilot = VehicleClock(), Autopilot()
    with ClockFollower(clock).following(autopilot):
        autopilot.tell(7.0)
        assert clock.monotonic() == 7.0
        autopilot.tell(99.0, component=154)  # a payload has its own
        assert clock.monotonic() == 7.0
        sleeping = asyncio.create_task(clock.sleep(1.0))
        await asyncio.sleep(0)
        autopilot.tell(0.5)
        autopilot.tell(1.0)
        assert clock.monotonic() == 7.5
        autopilot.tell(1.6)
        async with asyncio.timeout(20):
            await sleeping
    assert clock.monotonic() == pytest.approx(8.1)


async def test_time_advances_without_a_lost_autopilot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.dryrun.clock_follower._LOOK_S", 0.01)
    clock, autopilot = VehicleClock(), Autopilot()
    async with asyncio.timeout(20):
        with ClockFollower(clock).following(autopilot):
            autopilot.tell(7.0)
            told_s = clock.monotonic()
            await clock.sleep(0.1)
            assert clock.monotonic() >= told_s + 0.1 - 1e-6


async def test_speedup_is_reduced_when_commands_take_too_long() -> None:
    clock, autopilot, asked = VehicleClock(), Autopilot(), list[float]()
    slower = asyncio.Event()

    async def set_speed(speed: float) -> None:
        asked.append(speed)
        slower.set()
        raise DeviceError("which may fail")

    follower = ClockFollower(clock)
    now_s = 7.0
    async with asyncio.timeout(20):
        with follower.following(autopilot):
            autopilot.tell(now_s)
            follower.govern(20.0, set_speed)
            while not slower.is_set():
                with clock.work():
                    now_s += 5 * WORK_S
                    autopilot.tell(now_s)
                await asyncio.sleep(0)
    assert asked == [pytest.approx(4.0)]


@given(st.floats(0.001, 0.1), st.floats(1.0, 50.0))
def test_speedup_converges_to_the_permitted_work_time(work_real_s: float, wanted: float) -> None:
    controller = SpeedupController(wanted)
    for _ in range(60):
        controller.record(work_real_s * controller.speed)
    best = min(wanted, max(1.0, WORK_S / work_real_s))
    assert best / 1.2 <= controller.speed <= best * 1.2
    assert controller.speed <= wanted


def test_speedup_is_never_below_real_time_and_recovers() -> None:
    controller = SpeedupController(20.0)
    for _ in range(20):
        controller.record(2.0)
    assert controller.speed == 1.0
    for _ in range(60):
        controller.record(0.001 * controller.speed)
    assert 20.0 / 1.15 <= controller.speed <= 20.0  # small changes are not worth a message
    slow = SpeedupController(0.5)
    for _ in range(20):
        slow.record(2.0)
    assert slow.speed == 0.5


async def test_between_two_messages_the_clock_goes_on_at_the_autopilots_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    real_s = 100.0
    monkeypatch.setattr("panoexec.dryrun.clock_follower.monotonic", lambda: real_s)
    clock, autopilot = VehicleClock(), Autopilot()
    with ClockFollower(clock).following(autopilot):
        for number in range(60):  # at twice real time
            autopilot.tell(7.0 + 0.02 * number)
            real_s += 0.01
        told_s = 7.0 + 0.02 * 59
        assert clock.monotonic() == pytest.approx(told_s + 0.018), "no further than to the next message"
        autopilot.tell(told_s + 0.02)
        real_s += 0.004
        assert clock.monotonic() == pytest.approx(told_s + 0.02 + 0.008)
        before_s = clock.monotonic()
        real_s += 3.0
        assert clock.monotonic() == pytest.approx(told_s + 0.02 + 0.018), "a silent autopilot has no time"
        autopilot.tell(told_s + 0.024)  # late: time does not go back
        assert clock.monotonic() >= before_s
        sleeping = asyncio.create_task(clock.sleep(0.02))
        async with asyncio.timeout(20):
            for _ in range(3):
                await asyncio.sleep(0)
            autopilot.tell(told_s + 0.05)
            real_s += 0.004
            await sleeping
