"""What stations do about missions and flights that go wrong, as docs/stations.md says; and nothing accepted is untrue.

On ArduPilot's and PX4's own software where ARDUPILOT_SITL and PX4_SITL name it; on the embedded vehicle with
PANOEXEC_ALL_FAULTS=1 (`tests/unit/daemon/test_stations.py` has each in virtual time).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.mavlink.dialect import mavlink
from tests.system.sitl_kinds import ARDUCOPTER, PX4, Autopilot
from tests.system.station_flights import FLOWN, Flight, embedded_flight, sitl_flight
from tests.wire.broker import needs_mosquitto

pytestmark = needs_mosquitto

ALL_FAULTS = os.environ.get("PANOEXEC_ALL_FAULTS", "0") not in {"", "0"}
HOLD_S = 40.0
CONFIG = """[presets.small]
elevation_deg = [-10, 15]
azimuth_deg = [-30, 30]
method = "paper"
[presets.other]
elevation_deg = [-10, 15]
azimuth_deg = [150, 210]
method = "paper"
[presets.half]
elevation_deg = [-10, 15]
azimuth_deg = [-120, 120]
method = "paper"
[stations]
enabled = true
"""
Opens = Callable[..., AbstractAsyncContextManager[Flight]]


def _on(*which: str) -> pytest.MarkDecorator:
    """Run a test on these vehicles: `embedded-ardupilot`, `embedded-px4`, `ardupilot`, `px4`."""
    cases = []
    for name in which:
        sitl = {"ardupilot": ARDUCOPTER, "px4": PX4}.get(name)
        if sitl is None:
            skip = pytest.mark.skipif(not ALL_FAULTS, reason="set PANOEXEC_ALL_FAULTS=1 to run it")
        else:
            skip = pytest.mark.skipif(
                not os.environ.get(sitl.variable), reason=f"set {sitl.variable} to its SITL binary to run it"
            )
        cases.append(pytest.param(_opener(name, sitl), id=name, marks=skip))
    return pytest.mark.parametrize("opens", cases)


def _opener(name: str, sitl: Autopilot | None) -> Opens:
    @asynccontextmanager
    async def opened(folder: Path, more: str = CONFIG, **settings: Any) -> AsyncIterator[Flight]:
        kind: Any = name.removeprefix("embedded-")
        second = settings.pop("second", None)
        flight = (
            embedded_flight(folder, more, autopilot=kind, second=second)
            if sitl is None
            else sitl_flight(folder, more, sitl, second=second, **settings)
        )
        async with flight as one:
            try:
                yield one
            finally:
                said = one.pilot.said
                print(f"\n{name}: outcomes {one.outcomes}, {one.reasons}, told {said.told}, current {said.current}")
                print(f"{name}: {said.texts}, modes {said.modes}")
                if one.second is not None:
                    print(f"{name}, second: outcomes {one.second.outcomes}, {one.second.reasons}")
            assert one.untruths() == []

    return opened


ALL = ("embedded-ardupilot", "embedded-px4", "ardupilot", "px4")


@_on(*ALL)
async def test_unknown_presets_loops_and_uploads(opens: Opens, tmp_path: Path) -> None:
    steps = [
        ("station", 12, 9, 12.0),
        ("station", 24, 1, HOLD_S),
        ("waypoint", 30),
        ("jump", 2, 1),
        ("station", 36, 2, HOLD_S),
        ("waypoint", 60),
    ]
    async with opens(tmp_path) as one, one.running():
        unknown, known, last = one.first, one.first + 2, one.first + 6
        said = one.pilot.said
        await one.begin(*steps)
        await one.pilot.until(lambda: f"Pano: waypoint {unknown}: there is no preset 9, 3 are" in said.texts)
        await one.pilot.until(lambda: f"Pano: waypoint {known}: done already, not again" in said.texts, 240)
        assert [waypoint for waypoint, _ in one.outcomes] == [known]
        await one.at(last)
        await one.until_state("capturing", 1)
        told = len(said.told)
        await one.upload(*steps[:-1], ("waypoint", 70))
        await one.ground.until(lambda: one.closed() == 2, 180)
        assert [waypoint for waypoint, _ in one.outcomes] == [known, last]
        assert {outcome for _, outcome in one.outcomes} <= FLOWN
        await asyncio.sleep(2.0)
        assert said.told[told:] == []


@_on(*ALL)
async def test_the_pilot_takes_over_and_jumps(opens: Opens, tmp_path: Path) -> None:
    steps = [("station", 12 * n, 3, HOLD_S) for n in (1, 2, 3)]
    async with opens(tmp_path) as one, one.running():
        first, second, third = (one.first + 2 * n for n in range(3))
        said = one.pilot.said
        await one.begin(*steps, ("waypoint", 60))
        await one.until_state("capturing", 1)
        await one.pilot.mode("loiter")
        await one.until_state("paused")
        assert "the pilot has taken over" in one.ground.state["reason"]
        told = len(said.told)
        await asyncio.sleep(3.0)
        await one.pilot.mode("auto")
        await one.at(second)
        assert said.told[told:] == []
        await one.until_state("capturing", 1)
        one.pilot.jump_to(third)
        await one.ground.until(lambda: one.closed() == 2, 60)
        await one.at(third)
        await one.until_state("capturing", 1)
        told = len(said.told)
        one.pilot.jump_to(second)
        await one.pilot.until(lambda: f"Pano: waypoint {second}: done already, not again" in said.texts, 60)
        assert said.told[told:] == []
        assert one.outcomes == [(first, "incomplete"), (second, "incomplete"), (third, "incomplete")]
        assert all("the vehicle flew on" in reason for reason in one.reasons)


@_on(*ALL)
async def test_a_battery_that_does_not_suffice(opens: Opens, tmp_path: Path) -> None:
    async with opens(tmp_path, "hover_min = 0.02\n" + CONFIG) as one, one.running():
        await one.begin(("station", 12, 1, HOLD_S), ("station", 24, 2, HOLD_S), ("waypoint", 40))
        await one.at(one.first + 4)
        await one.ground.until(lambda: one.closed() == 2, 30)
        assert one.outcomes == [(one.first, "skipped"), (one.first + 2, "skipped")]
        assert all(reason.startswith("battery at ") for reason in one.reasons)
        assert sum("skipped: battery at " in text for text in one.pilot.said.texts) == 2
        assert one.pilot.said.told == [f"current {one.first + 1}", f"current {one.first + 3}"]
        assert one.manifests() == []


@_on(*ALL)
async def test_two_with_the_same_ids(opens: Opens, tmp_path: Path) -> None:
    async with opens(tmp_path, second=CONFIG) as one:
        assert one.second is not None
        async with one.running(), one.second.running():
            await one.begin(("station", 12, 1, 12.0), ("waypoint", 40))
            await one.at(one.first + 2)
            await one.ground.until(lambda: one.closed() == 1, 30)
        assert one.outcomes == one.second.outcomes == [(one.first, "skipped")]
        assert one.pilot.said.told == []


@_on(*ALL)
async def test_two_with_different_ids(opens: Opens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with opens(tmp_path, second=CONFIG) as one:
        assert one.second is not None
        other = one.second
        async with one.running():
            monkeypatch.setenv("PANOEXEC_VEHICLE__COMPONENT_ID", "192")
            async with other.running():
                await one.begin(("station", 12, 1, HOLD_S), ("station", 24, 1, HOLD_S), ("waypoint", 40))
                await one.at(one.first + 4)
                await one.ground.until(lambda: one.closed() == 2, 30)
                await other.ground.until(lambda: other.closed() == 2, 30)
        assert [waypoint for waypoint, outcome in one.outcomes if outcome in FLOWN] == [one.first, one.first + 2]
        assert other.outcomes == [(one.first, "skipped"), (one.first + 2, "skipped")]
        assert other.reasons == ["the panoexec of component 191 does it"] * 2
        assert one.manifests()
        assert not other.manifests()


@_on("ardupilot", "px4")
async def test_a_battery_at_its_floor(opens: Opens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOEXEC_GUARDS__BATTERY_FLOOR_FRAC", "0.3")
    async with opens(tmp_path) as one, one.running():
        await one.begin(("station", 12, 3, HOLD_S), ("waypoint", 40))
        await one.until_state("capturing", 1)
        if one.kind == "ardupilot":
            one.pilot.parameter("BATT_CAPACITY", 200.0)
        else:
            one.pilot.parameter("SIM_BAT_MIN_PCT", 15.0)
            one.pilot.parameter("SIM_BAT_DRAIN", 1.0)
        await one.ground.until(lambda: one.closed() == 1, 30)
        await one.at(one.first + 2)
        assert one.outcomes == [(one.first, "incomplete")]
        assert "cannot go on here" in one.reasons[0]
        assert one.pilot.said.told[-1:] == [f"current {one.first + 1}"]


@_on("ardupilot", "px4")
async def test_no_gps_no_arrival(opens: Opens, tmp_path: Path) -> None:
    """The estimator's failsafe changes the mode; the pilot flies the mission on when the GPS is back."""
    async with opens(tmp_path) as one, one.running():
        said = one.pilot.said
        await one.begin(("station", 60, 1, HOLD_S), ("waypoint", 80))
        await one.at(one.first)
        auto = said.custom_mode
        name, without, with_gps, whole = (ARDUCOPTER if one.kind == "ardupilot" else PX4).gps
        one.pilot.parameter(name, without, whole=whole)
        await one.pilot.until(lambda: said.fix_type < 3, 20)
        with contextlib.suppress(TimeoutError):
            await one.pilot.until(lambda: said.custom_mode != auto, 12)
        print(f"{one.kind} without GPS: mode {said.custom_mode}, {one.outcomes}, {said.autopilot_texts[-4:]}")
        assert one.outcomes == []
        assert said.told == []
        one.pilot.parameter(name, with_gps, whole=whole)
        await one.pilot.mode_at_last("auto")
        await one.at(one.first + 2)
        await one.ground.until(lambda: one.closed() == 1, 30)
        assert one.outcomes[0][1] in FLOWN


SWITCHES = """[rc]
start_channel = 9
abort_channel = 10
preset = "small"
"""
LOW, HIGH, FAILSAFE_THROTTLE = 1000, 2000, 950


@_on("ardupilot", "px4")
async def test_a_receiver_that_is_lost_moves_no_switch(opens: Opens, tmp_path: Path) -> None:
    """Its presets, and what it puts out when it is back, are not the pilot's hand."""
    radio = {"COM_RC_IN_MODE": 0, "RC_MAP_ROLL": 1, "RC_MAP_PITCH": 2, "RC_MAP_THROTTLE": 3, "RC_MAP_YAW": 4}
    px4 = radio | {"RC_FAILS_THR": 975, "RC_CHAN_CNT": 18, "NAV_RCL_ACT": 2}
    settings = px4 if "px4" in os.environ.get("PYTEST_CURRENT_TEST", "") else {}
    async with opens(tmp_path, CONFIG + SWITCHES, **settings) as one:
        receiver = Receiver(one)
        sending = asyncio.create_task(receiver.run(), name="receiver")
        try:
            async with one.running():
                await _lose_the_receiver(one, receiver)
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)


async def _lose_the_receiver(one: Flight, receiver: Receiver) -> None:
    def moved() -> int:
        return (one.folder / "serve.log").read_text().count("switch of the transmitter")

    await one.begin(("station", 12, 3, HOLD_S), ("waypoint", 40))
    await one.until_state("capturing", 1)
    before = one.pilot.said.custom_mode
    receiver.put_out(FAILSAFE_THROTTLE, HIGH, HIGH)
    await one.pilot.until(lambda: one.pilot.said.custom_mode != before, 20)
    await one.until_state("paused")
    told = len(one.pilot.said.told)
    assert "the pilot has taken over" in one.ground.state["reason"]
    await asyncio.sleep(4.0)
    receiver.put_out(1500, HIGH, HIGH)  # it is back, and they stand high
    await asyncio.sleep(4.0)
    receiver.put_out(1500, LOW, LOW)
    await asyncio.sleep(2.0)
    receiver.pulses = False
    await asyncio.sleep(4.0)
    receiver.put_out(1500, HIGH, HIGH)
    receiver.pulses = True
    await asyncio.sleep(4.0)
    assert moved() == 0
    assert one.ground.state["state"] == "paused"
    assert one.pilot.said.told[told:] == []
    receiver.put_out(1500, LOW, LOW)
    await asyncio.sleep(3.0)
    receiver.put_out(1500, LOW, HIGH)  # the pilot's hand
    await one.ground.until(lambda: one.ground.state["state"] == "aborted", 20)
    assert moved() == 1


class Receiver:
    """Puts out channels: to ArduPilot's SITL as its simulated receiver does, to PX4 by RC_CHANNELS_OVERRIDE."""

    def __init__(self, one: Flight) -> None:
        self.pulses = True
        self._one = one
        # the others as ArduPilot's SITL has them by itself, so that no flight mode is chosen
        self._channels = [1500, 1500, LOW, 1500, 1800, LOW, LOW, 1800, *[LOW] * 8]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._port = 0
        if one.kind == "ardupilot":
            assert one.sitl is not None
            words = Path(f"/proc/{one.sitl.pid}/cmdline").read_bytes().split(b"\0")
            self._port = int(words[words.index(b"--rc-in-port") + 1])

    def put_out(self, throttle: int, start: int, abort: int) -> None:
        self._channels[2], self._channels[8], self._channels[9] = throttle, start, abort

    async def run(self) -> None:
        """Put them out 20 times a second, until cancelled."""
        await self._one.pilot.until(lambda: self._one.pilot.said.custom_mode >= 0)
        with contextlib.closing(self._socket):
            while True:
                if self._port:
                    self._one.pilot.parameter("SIM_RC_FAIL", 0 if self.pulses else 1)
                    self._socket.sendto(struct.pack("<16H", *self._channels), ("127.0.0.1", self._port))
                elif self.pulses:
                    self._one.pilot.send(mavlink.MAVLink_rc_channels_override_message(1, 1, *self._channels, 0, 0))
                await asyncio.sleep(0.05)
