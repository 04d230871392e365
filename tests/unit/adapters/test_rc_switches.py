"""A switch acts when a hand has moved it, and at nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.rc_switches import HIGH_US, LOW_US, STALE_S, RcSwitches, Switch

READ_S = 0.2


class Bench:
    """Feeds a switch five times a second, and the receiver's state once a second."""

    def __init__(self) -> None:
        self.switch, self.now_s, self.acted = Switch(), 100.0, 0

    def hold(self, pulse_us: int, seconds: float, *, receiver: bool = True) -> None:
        for _ in range(round(seconds / READ_S)):
            self.now_s += READ_S
            self.switch.read(pulse_us, self.now_s)
            if round(self.now_s / READ_S) % 5 == 0:
                if not receiver:
                    self.switch.forget()
                elif self.switch.works(self.now_s):
                    self.acted += 1


def test_it_acts_once_when_it_is_moved_and_once_more_when_it_is_moved_again() -> None:
    bench = Bench()
    bench.hold(1000, 1.0)
    bench.hold(2000, 10.0)
    assert bench.acted == 1
    bench.hold(1000, 1.0)
    bench.hold(2000, 3.0)
    assert bench.acted == 2


def test_one_that_stands_high_at_boot_does_nothing() -> None:
    bench = Bench()
    bench.hold(2000, 60.0)
    assert bench.acted == 0


def test_a_short_touch_and_a_glitch_do_nothing() -> None:
    bench = Bench()
    bench.hold(1000, 2.0)
    bench.hold(2000, 0.6)
    bench.hold(1000, 5.0)
    assert bench.acted == 0
    bench.hold(2000, 0.6)
    bench.hold(1500, 0.2)
    bench.hold(2000, 0.6)
    bench.hold(1000, 3.0)
    assert bench.acted == 0


def test_a_preset_that_the_receiver_puts_out_without_signal_does_nothing() -> None:
    bench = Bench()
    bench.hold(1000, 5.0)
    bench.hold(2000, 0.6)  # not told yet
    bench.hold(2000, 10.0, receiver=False)
    bench.hold(2000, 10.0)  # the signal is back, with the switch as it stands
    assert bench.acted == 0


def test_channels_that_do_not_exist_and_streams_that_end_need_a_low_again() -> None:
    for pulse_us in (0, 65535):
        bench = Bench()
        bench.hold(1000, 2.0)
        bench.hold(pulse_us, 0.4)
        bench.hold(2000, 5.0)
        assert bench.acted == 0
    bench = Bench()
    bench.hold(1000, 2.0)
    bench.now_s += STALE_S + 1.0
    bench.hold(2000, 5.0)
    assert bench.acted == 0


class Vehicle:
    """A link to an autopilot: RC_CHANNELS five times a second, SYS_STATUS once a second."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.now_s, self.acted = 100.0, 0
        self._handlers: dict[str, Callable[[MavMessage], None]] = {}
        patch.setattr("panoexec.adapters.rc_switches.time.monotonic", lambda: self.now_s)
        RcSwitches(cast("Any", self), {8: self._act})

    def on(self, name: str, handler: Callable[[MavMessage], None]) -> Callable[[], None]:
        self._handlers[name] = handler
        return lambda: None

    def post(self, action: Callable[[], None]) -> None:
        action()

    def _act(self) -> None:
        self.acted += 1

    def hold(self, pulse_us: int, seconds: float, *, receiver: bool = True) -> None:
        for _ in range(round(seconds / READ_S)):
            self.now_s += READ_S
            self._hear("RC_CHANNELS", {"chan8_raw": pulse_us})
            if round(self.now_s / READ_S) % 5 == 0:
                kinds = ("present", "enabled", "health")
                self._hear("SYS_STATUS", {f"onboard_control_sensors_{kind}": 65536 * receiver for kind in kinds})

    def _hear(self, name: str, fields: dict[str, Any]) -> None:
        self._handlers[name](MavMessage(name, 1, fields, self.now_s))


def test_a_switch_on_the_vehicle_acts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = Vehicle(monkeypatch)
    vehicle.hold(1000, 3.0)
    vehicle.hold(2000, 5.0)
    assert vehicle.acted == 1


def test_the_last_pulses_that_are_sent_on_without_a_receiver_count_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = Vehicle(monkeypatch)
    vehicle.hold(1000, 3.0)
    vehicle.hold(1000, 4.8, receiver=False)
    vehicle.hold(2000, 10.0)
    assert vehicle.acted == 0


@given(st.lists(st.tuples(st.integers(LOW_US, 2100), st.integers(1, 20)), max_size=30))
def test_without_a_low_it_never_acts(pulses: list[tuple[int, int]]) -> None:
    bench = Bench()
    for pulse_us, readings in pulses:
        bench.hold(pulse_us, readings * READ_S)
    assert bench.acted == 0


@given(st.lists(st.tuples(st.integers(800, HIGH_US), st.integers(1, 20)), max_size=30))
def test_without_a_high_it_never_acts(pulses: list[tuple[int, int]]) -> None:
    bench = Bench()
    for pulse_us, readings in pulses:
        bench.hold(pulse_us, readings * READ_S)
    assert bench.acted == 0
