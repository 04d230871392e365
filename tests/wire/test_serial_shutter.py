"""The cable release: bytes over a pseudo-terminal pair; pulses on a port that remembers its lines."""

from __future__ import annotations

import asyncio
import os
import pty
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial

from panoexec.adapters.camera import serial_shutter
from panoexec.adapters.camera.serial_shutter import Line, SerialShutter
from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.clock import SystemClock
from panoexec.devices import Camera, EvidenceLevel
from panoexec.errors import LinkError
from tests.waiting import eventually

CLOCK = SystemClock()


class Pair:
    """A pseudo-terminal: the shutter opens `name`, the test reads the other end."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        self._slave = slave

    def read(self) -> bytes:
        return os.read(self.master, 100)

    def close(self) -> None:
        for end in (self.master, self._slave):
            if end >= 0:
                os.close(end)
        self.master = self._slave = -1


@pytest.fixture
def pair() -> Iterator[Pair]:
    one = Pair()
    yield one
    one.close()


class LinePort:
    """A serial port that has real control lines, unlike a pseudo-terminal."""

    def __init__(self) -> None:
        self.events: list[tuple[str, bool, float]] = []
        self.levels = {"rts": True, "dtr": True}
        self.is_open = False
        self.broken = False
        self.port = ""
        self.baudrate = 0
        self.write_timeout = 0.0

    def open(self) -> None:
        if self.broken:
            raise serial.SerialException("could not open port")
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def _set(self, line: str, level: bool) -> None:
        if self.broken:
            raise OSError(5, "Input/output error")
        self.levels[line] = level
        if self.is_open:
            self.events.append((line, level, time.monotonic()))

    rts = property(lambda self: self.levels["rts"], lambda self, level: self._set("rts", level))
    dtr = property(lambda self: self.levels["dtr"], lambda self, level: self._set("dtr", level))


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> list[LinePort]:
    made: list[LinePort] = []

    def make() -> LinePort:
        made.append(LinePort())
        return made[-1]

    monkeypatch.setattr(serial, "Serial", make)
    return made


async def test_bytes_reach_the_adapter_and_nothing_more_can_be_known(pair: Pair) -> None:
    async with SerialShutter(pair.name, clock=CLOCK, line="bytes", payload=b"S1\r\n") as shutter:
        camera: Camera = shutter
        before = CLOCK.monotonic()
        capture = await camera.trigger()
        assert pair.read() == b"S1\r\n"
        assert before <= capture.commanded_s <= CLOCK.monotonic()
        async with asyncio.timeout(60):  # at once, long before it would give up
            assert (await capture.evidence(EvidenceLevel.COUNTED, 3600.0)).level is EvidenceLevel.COMMANDED
        assert camera.storage_free_images == float("inf")


class Pulses:
    """Pulses that last until the test says that they are over.

    Attributes:
        asked: how long each was to last.
    """

    def __init__(self) -> None:
        self.asked: list[float] = []
        self.over = threading.Event()

    def sleep(self, seconds: float) -> None:
        self.asked.append(seconds)
        assert self.over.wait(60)


@pytest.fixture
def pulses(monkeypatch: pytest.MonkeyPatch) -> Pulses:
    made = Pulses()
    monkeypatch.setattr(serial_shutter, "time", made)
    return made


@pytest.mark.parametrize("line", ["rts", "dtr"])
@pytest.mark.parametrize("inverted", [False, True])
async def test_a_pulse_closes_the_contact_until_it_is_over(
    ports: list[LinePort], pulses: Pulses, line: Line, inverted: bool
) -> None:
    async with SerialShutter("/dev/ttyUSB9", clock=CLOCK, line=line, pulse_s=0.1, inverted=inverted) as shutter:
        (port,) = ports
        assert port.levels == {"rts": inverted, "dtr": inverted}  # the contact is open
        capture = await shutter.trigger()  # returns when it is closed, not when it is opened again
        assert port.levels[line] is not inverted
        second = asyncio.create_task(shutter.trigger())
        for _ in range(9):  # and the loop is not blocked
            await asyncio.sleep(0.005)
        assert not second.done(), "it waits for the end of the pulse"
        pulses.over.set()
        following = await second
        assert following.commanded_s > capture.commanded_s
    assert pulses.asked == [0.1, 0.1]
    closed, opened, closed_again, opened_again = port.events[:4]
    assert [event[:2] for event in (closed, opened, closed_again, opened_again)] == [
        (line, not inverted),
        (line, inverted),
    ] * 2
    assert closed[2] <= opened[2] <= closed_again[2] <= opened_again[2]
    assert port.levels[line] is inverted
    assert not port.is_open


async def test_a_pulse_lasts_its_time(ports: list[LinePort]) -> None:
    async with SerialShutter("/dev/ttyUSB9", clock=CLOCK, pulse_s=0.1) as shutter:
        capture = await shutter.trigger()
        following = await shutter.trigger()
        assert following.commanded_s - capture.commanded_s >= 0.1
    closed, opened = ports[0].events[:2]
    assert opened[2] - closed[2] >= 0.1


async def test_a_port_that_cannot_be_opened_says_so() -> None:
    with pytest.raises(LinkError, match="serial shutter /dev/no-such-port: "):
        async with SerialShutter("/dev/no-such-port", clock=CLOCK):
            pass


async def test_a_port_that_was_unplugged_heals(ports: list[LinePort]) -> None:
    async with SerialShutter("/dev/ttyUSB9", clock=CLOCK, pulse_s=0.01) as shutter:
        await shutter.trigger()
        await eventually(lambda: not ports[0].levels["rts"])  # the pulse is over
        ports[0].broken = True
        with pytest.raises(LinkError, match="serial shutter /dev/ttyUSB9: Input/output error"):
            await shutter.trigger()
        await shutter.trigger()
        assert len(ports) == 2
        assert ports[1].levels["rts"]


async def test_a_pseudo_terminal_that_went_away_is_a_link_error() -> None:
    pair = Pair()
    async with SerialShutter(pair.name, clock=CLOCK, line="bytes", payload=b"S") as shutter:
        await shutter.trigger()
        pair.close()
        with pytest.raises(LinkError, match="serial shutter"):
            await shutter.trigger()


class Feedback:
    """A link that delivers CAMERA_FEEDBACK."""

    def __init__(self) -> None:
        self.handler: Handler | None = None

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        assert name == "CAMERA_FEEDBACK"
        self.handler = handler

        def off() -> None:
            self.handler = None

        return off

    def post(self, callback: Callable[..., None], *args: object) -> None:
        callback(*args)

    def say(self, index: int) -> None:
        fields: dict[str, Any] = {"time_usec": 7_000_000, "img_idx": index, "lat": 0, "lng": 0, "alt_msl": 0.0}
        assert self.handler is not None
        self.handler(MavMessage("CAMERA_FEEDBACK", 1, fields, CLOCK.monotonic()))


async def test_a_hot_shoe_on_the_autopilot_proves_the_photo(pair: Pair) -> None:
    feedback = Feedback()
    async with SerialShutter(pair.name, clock=CLOCK, line="bytes", payload=b"S", feedback=feedback) as shutter:
        first = await shutter.trigger()
        second = await shutter.trigger()
        feedback.say(5)
        assert (await second.evidence(EvidenceLevel.FEEDBACK_PIN, 60.0)).level is EvidenceLevel.FEEDBACK_PIN
        assert (await first.evidence(EvidenceLevel.FEEDBACK_PIN, 0.0)).level is EvidenceLevel.COMMANDED
    assert feedback.handler is None
