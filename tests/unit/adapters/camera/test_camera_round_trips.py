"""Bounds of the shutter's opening never exclude it, whatever else the camera sends, and whatever the link does to it.

A scripted camera behind the real `CameraReports`: it sends its capture status unasked, answers before or after it
acknowledges, and its clock is slow or fast; the link delays in order, holds up, loses and now and then reorders.
`PANOEXEC_CAMERA_CLOCKS=2000` flies so many of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest

from panoexec.adapters.camera.camera_reports import CameraReports
from panoexec.adapters.camera.camera_round_trips import RoundTrips
from panoexec.adapters.camera.mavlink_camera_found import MavlinkCameraFound
from panoexec.adapters.link.message_hub import Handler, MavMessage
from panoexec.errors import DeviceError
from tests.unit.fakes.virtual import VirtualClock, run_virtual

CAMERA = 100
STATUS, REQUEST = "CAMERA_CAPTURE_STATUS", 512
CASES = int(os.environ.get("PANOEXEC_CAMERA_CLOCKS", "24"))


@dataclass(frozen=True, kw_only=True)
class Habits:
    """Of a camera and its link.

    Attributes:
        rate: camera seconds per second.
        delay_s: shortest and longest time under way, each way.
        answers_first: it answers a request, then acknowledges it.
        answer_s: from one of both to the other.
        unasked_s: after a report, it sends its status by itself so much later; None: it does not.
        every_s: it sends its status so often; 0: it does not.
        others_s: MAVSDK requests its status as well, so often.
        lost: probability that a message is lost, either way.
        reordered: that it overtakes or is overtaken.
        held_s: now and then nothing arrives for up to so long.
    """

    rate: float = 1.0
    delay_s: tuple[float, float] = (0.001, 0.004)
    answers_first: bool = False
    answer_s: float = 0.001
    unasked_s: float | None = None
    every_s: float = 0.0
    others_s: float = 5.0
    lost: float = 0.0
    reordered: float = 0.0
    held_s: float = 0.0


@dataclass
class ScriptedLink:
    """Stands for `MavsdkLink` and its requests, with a camera at its other end.

    As MAVSDK does, it has one request of a kind under way at a time, repeats it after 0.5 s, and takes the next
    acknowledgement for its own.
    """

    habits: Habits
    rng: random.Random
    clock: VirtualClock = field(default_factory=VirtualClock)
    handlers: dict[str, list[Handler]] = field(default_factory=dict)
    tasks: set[asyncio.Task[None]] = field(default_factory=set)
    photos: int = 0

    def __post_init__(self) -> None:
        self.requests = self
        self._busy = asyncio.Lock()
        self._acknowledged = asyncio.Event()
        self._in_order_s = {"up": 0.0, "down": 0.0}
        self._held_until_s = 0.0

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        self.handlers.setdefault(name, []).append(handler)
        return lambda: None

    def post(self, callback: Callable[..., None], *args: object) -> None:
        callback(*args)

    async def command(self, command: int, params: Sequence[float] = (), *, component: int = 1) -> int:
        assert (command, component) == (REQUEST, CAMERA)
        async with self._busy:
            self._acknowledged.clear()
            for _ in range(4):
                self._carry("up", lambda: self._asked(int(params[0])))
                try:
                    async with asyncio.timeout(0.5):
                        await self._acknowledged.wait()
                except TimeoutError:
                    continue
                return 0
        raise DeviceError("not answered")

    def camera_ms(self) -> int:
        return int(1000 * (77.3 + self.habits.rate * (self.clock.monotonic() - 1000.0)))

    def status(self) -> None:
        stamp_ms, count = self.camera_ms(), self.photos
        self._carry("down", lambda: self._hear(STATUS, {"time_boot_ms": stamp_ms, "image_count": count}))

    def later(self, delay_s: float, call: Callable[[], None]) -> None:
        async def wait() -> None:
            await self.clock.sleep(delay_s)
            call()

        task = asyncio.get_running_loop().create_task(wait())
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def shoot(self, heard: Callable[[int, float], None]) -> None:
        """Take a photo and report it; `heard` gets its stamp when the report arrives, before the adapter does."""
        stamp_ms, self.photos = self.camera_ms(), self.photos + 1
        fields = {"time_boot_ms": stamp_ms, "time_utc": 0, "lat": 0, "lon": 0, "alt": 0}
        fields |= {"image_index": self.photos, "capture_result": 1}

        def arrive() -> None:
            heard(stamp_ms, self.clock.monotonic())
            self._hear("CAMERA_IMAGE_CAPTURED", fields | {"file_url": ""})

        def report() -> None:
            self._carry("down", arrive)
            if self.habits.unasked_s is not None:
                self.later(self.habits.unasked_s, self.status)

        self.later(self.rng.uniform(0.02, 0.1), report)

    async def others(self) -> None:
        while True:
            await self.clock.sleep(self.rng.uniform(0.5, 1.5) * self.habits.others_s)
            for wanted in (259, 262):
                try:
                    await self.command(REQUEST, [wanted], component=CAMERA)
                except DeviceError:
                    continue

    async def unasked(self) -> None:
        while self.habits.every_s:
            await self.clock.sleep(self.habits.every_s * self.rng.uniform(0.9, 1.1))
            self.status()

    def _asked(self, wanted: int) -> None:
        def acknowledge() -> None:
            self._carry("down", self._hear_acknowledgement)

        answer = self.status if wanted == 262 else lambda: None
        first, then = (answer, acknowledge) if self.habits.answers_first else (acknowledge, answer)
        first()
        self.later(self.habits.answer_s, then)

    def _hear_acknowledgement(self) -> None:
        self._hear("COMMAND_ACK", {"command": REQUEST, "result": 0})
        self._acknowledged.set()

    def _hear(self, name: str, fields: dict[str, Any]) -> None:
        for handler in self.handlers.get(name, ()):
            handler(MavMessage(name, CAMERA, fields, self.clock.monotonic()))

    def _carry(self, way: str, arrive: Callable[[], None]) -> None:
        habits, rng, now_s = self.habits, self.rng, self.clock.monotonic()
        if rng.random() < habits.lost:
            return
        if habits.held_s and rng.random() < 0.01:
            self._held_until_s = now_s + rng.uniform(0.0, habits.held_s)
        at_s = max(now_s + rng.uniform(*habits.delay_s), self._held_until_s)
        if rng.random() < habits.reordered:
            at_s += rng.uniform(0.0, 0.03)
        else:
            at_s = self._in_order_s[way] = max(at_s, self._in_order_s[way] + 1e-5)
        self.later(at_s - now_s, arrive)


@dataclass
class Flown:
    """What was bounded: photos, bounded ones, and how far the true opening was outside of bounds."""

    photos: int = 0
    bounded: int = 0
    wrong_s: list[float] = field(default_factory=list)


def flown(habits: Habits, *, seed: int, photos: int = 14) -> Flown:
    """Photos every two to four seconds, and what the bounds of their openings are when their reports arrive."""

    async def fly() -> Flown:
        link, out = ScriptedLink(habits, random.Random(seed)), Flown()
        reports = CameraReports(link, component=CAMERA, mib_per_image=None)  # type: ignore[arg-type]
        reports.found = MavlinkCameraFound(component=CAMERA)
        reports.subscribe()
        background = [asyncio.create_task(link.others()), asyncio.create_task(link.unasked())]
        try:
            await link.clock.sleep(1.0)
            with contextlib.suppress(DeviceError):
                await reports.relate()
            for _ in range(photos):
                await link.clock.sleep(link.rng.uniform(2.0, 4.0))
                link.shoot(partial(check, reports, out, link.clock.monotonic()))
            await link.clock.sleep(3.0)
        finally:
            for task in (*background, *link.tasks):
                task.cancel()
            await asyncio.gather(*background, *link.tasks, return_exceptions=True)
            await reports.close()
        return out

    return run_virtual(fly())


def check(reports: CameraReports, out: Flown, true_s: float, stamp_ms: int, received_s: float) -> None:
    earliest_s, latest_s = reports.stamps.bounds(stamp_ms / 1000.0, received_s)
    out.photos += 1
    if math.isfinite(earliest_s):
        out.bounded += 1
        if not earliest_s - 1e-9 <= true_s <= latest_s + 1e-9:
            out.wrong_s.append(min(true_s - earliest_s, latest_s - true_s))


@pytest.mark.parametrize("answers_first", [False, True])
@pytest.mark.parametrize("delay_s", [0.002, 0.03, 0.06])
def test_a_status_that_is_sent_unasked_after_a_photo_is_no_answer(delay_s: float, answers_first: bool) -> None:
    """It was stamped before the request that its report caused, and arrives after that was sent."""
    habits = Habits(delay_s=(0.8 * delay_s, delay_s), unasked_s=0.001, answers_first=answers_first)
    found = flown(habits, seed=3)
    assert found.wrong_s == []
    if delay_s < 0.01:
        assert found.bounded >= 0.9 * found.photos
    elif delay_s < 0.02:
        assert found.bounded >= 0.5 * found.photos


def habits_of(rng: random.Random) -> Habits:
    shortest_s = rng.choice([0.0005, 0.002, 0.005, 0.015, 0.03, 0.06])
    return Habits(
        rate=rng.choice([1.0, 1.0, rng.uniform(0.95, 1.05)]),
        delay_s=(shortest_s, shortest_s * rng.choice([1.1, 2.0, 6.0])),
        answers_first=rng.random() < 0.5,
        answer_s=rng.choice([0.0002, 0.003, 0.02]),
        unasked_s=rng.choice([None, 0.0, 0.001, 0.01, 0.05]),
        every_s=rng.choice([0.0, 0.0, 0.0, 1.0, 0.1, 0.04]),
        others_s=rng.choice([5.0, 1.0]),
        lost=rng.choice([0.0, 0.0, 0.02, 0.1]),
        reordered=rng.choice([0.0, 0.0, 0.02]),
        held_s=rng.choice([0.0, 0.0, 0.3, 2.0]),
    )


def test_bounds_never_exclude_the_true_opening() -> None:
    wrong, photos, bounded = [], 0, 0
    for seed in range(CASES):
        habits = habits_of(random.Random(seed))
        found = flown(habits, seed=seed)
        photos, bounded = photos + found.photos, bounded + found.bounded
        if found.wrong_s:
            wrong.append((seed, found.wrong_s, habits))
    print(f"{CASES} cameras, {photos} photos, {bounded} bounded, {sum(len(one[1]) for one in wrong)} wrongly")
    assert not wrong
    assert bounded > 0.15 * photos


def test_a_camera_that_answers_first_has_to_do_so_nine_times_in_a_row() -> None:
    """Until then, and after anything else, a round trip begins with the first of its two requests."""

    async def make() -> list[bool]:
        clock, asked_s, unasked = VirtualClock(), list[float](), False

        async def request() -> int:
            asked_s.append(clock.monotonic())
            await clock.sleep(0.01)
            trips.stamped(clock.monotonic(), clock.monotonic())
            trips.acknowledged(clock.monotonic())
            if unasked:
                trips.acknowledged(clock.monotonic())
            return 0

        trips, from_second = RoundTrips(clock, request), list[bool]()
        for number in range(24):
            unasked = number == 12
            asked_s.clear()
            trip = await trips.make()
            assert (trip is None) == unasked
            if trip is not None:
                assert trip.asked_s in asked_s[-2:]
                from_second.append(trip.asked_s == asked_s[-1])
            await clock.sleep(1.0)
        return from_second

    assert run_virtual(make()) == [False] * 8 + [True] * 4 + [False] * 8 + [True] * 3


def test_a_clock_that_is_stepped_again_and_again_holds_up_no_mission(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each step makes the round trips before it worthless, so enough are never together."""
    made = []

    async def relates() -> None:
        reports = CameraReports(ScriptedLink(Habits(), random.Random(1)), component=CAMERA, mib_per_image=None)  # type: ignore[arg-type]

        async def trip() -> bool:
            made.append(1)
            assert len(made) < 100, "without end"
            return len(made) % 2 == 1  # the next one finds a step

        monkeypatch.setattr(reports, "_make_trip", trip)
        await reports.relate()

    run_virtual(relates())
    assert len(made) > 5


def test_a_request_that_is_lost_does_not_end_the_round_trips(monkeypatch: pytest.MonkeyPatch) -> None:
    link, out = ScriptedLink(Habits(), random.Random(2)), Flown()
    made: list[int] = []

    async def relates() -> None:
        reports = CameraReports(link, component=CAMERA, mib_per_image=None)  # type: ignore[arg-type]
        reports.found = MavlinkCameraFound(component=CAMERA)
        reports.subscribe()
        command = link.command

        async def sometimes(*args: Any, **options: Any) -> int:
            made.append(1)
            if len(made) == 3:
                raise DeviceError("not answered")
            return await command(*args, **options)

        monkeypatch.setattr(link, "command", sometimes)
        await reports.relate()
        await link.clock.sleep(5.0)  # those that follow at intervals
        link.shoot(partial(check, reports, out, link.clock.monotonic()))
        await link.clock.sleep(1.0)
        await reports.close()

    run_virtual(relates())
    assert len(made) > 3
    assert (out.bounded, out.wrong_s) == (1, [])


def test_a_camera_that_never_acknowledges_is_told() -> None:
    async def relates() -> None:
        link = ScriptedLink(Habits(lost=1.0), random.Random(1))
        reports = CameraReports(link, component=CAMERA, mib_per_image=None)  # type: ignore[arg-type]
        reports.found = MavlinkCameraFound(component=CAMERA)
        await reports.relate()

    with pytest.raises(DeviceError):
        run_virtual(relates())
