"""One attempt at a shot: point, wait until settled, expose, judge every sample of the exposure."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeVar

from panoexec.angles import yaw_pitch_roll
from panoexec.clock import Clock
from panoexec.devices import Camera, CaptureEvidence, EvidenceLevel, Gimbal, PendingCapture
from panoexec.errors import DeviceError
from panoexec.mission.dated_exposure import ShutterLag, is_dated, window
from panoexec.mission.pointing.gate import SettleLimits, SettleTracker, Target, WindowVerdict, judge_window
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.pointing.poses import PoseReader, read_pose, to_north
from panoexec.mission.preflight import gimbal_limits
from panoexec.mission.protocols import PhotoMemory
from panoexec.mission.settings import MissionSettings
from panoexec.mission.waiting import until, within
from panoexec.planning.model import Shot
from panoexec.planning.order.duration import slew_time_s

T = TypeVar("T")

TRIGGER_BOUND_S = 10.0
"""An adapter answers or gives up long before this."""
AFTER_REFUSAL_S = 0.5
"""How long a camera that refused is left alone, if its interval is not shorter."""
LATE_S = 0.5
"""How long samples of an exposure may be on their way before they count as never sent."""
LAST_SLEEP_S = 0.05
"""The last part of a wait, slept through without a look at samples; those before are judged by then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NotSettled:
    """The attempt ends before its photo."""

    code: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Settled:
    """The pose is inside tolerance and still: trigger now.

    Attributes:
        commanded_s: when the pointing command went out.
        settled_s: when everything that the trigger waits for was there.
    """

    commanded_s: float
    settled_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """Photos taken, attitudes judged.

    Attributes:
        captures: one a photo, to wait on for evidence.
        verdict: on the attitudes from the first trigger to the end of the last exposure.
        trigger_utc_s: wall time of each trigger.
        trigger_delay_s: from settled to the first trigger on the wire.
        end_s: until when the attitudes were judged.
    failure: why not all photos were taken, "" if they were.
        images_before: how many images the camera counted before; -1 where that was not known.
        broken_off: somebody asked to hold or to end between two photos of a bracket.
    """

    captures: tuple[PendingCapture, ...]
    verdict: WindowVerdict
    trigger_utc_s: tuple[float, ...]
    trigger_delay_s: float
    end_s: float
    failure: str = ""
    images_before: int = -1
    broken_off: bool = False


@dataclass(kw_only=True)
class Shooter:
    """Knows how to take one photo with these devices.

    Attributes:
        reference_yaw_north_deg: direction of the plan's yaw 0 from true north.
        open_loop: there is no attitude feedback; believe the gimbal after the slew time.
        turner: turns the vehicle where the gimbal does not pan far enough; None: it is never turned.
    """

    gimbal: Gimbal
    camera: Camera
    clock: Clock
    settings: MissionSettings
    reference_yaw_north_deg: float
    open_loop: bool
    turner: HeadingController | None = None
    poses: PoseReader = field(init=False)
    lag: ShutterLag = field(init=False)
    _ready_s: float = field(default=-math.inf, init=False)
    _pointed: tuple[float, float] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Begin to read the attitude stream."""
        self.lag = ShutterLag(self.settings.latency_s)
        self.poses = PoseReader(feed=self.gimbal.feed, reference_yaw_north_deg=self.reference_yaw_north_deg)

    async def approach(
        self,
        shot: Shot,
        *,
        patience_s: float,
        clear: Callable[[], asyncio.Event | None],
        coming_yaw_deg: Sequence[float] = (),
    ) -> Settled | NotSettled:
        """Point at a shot and return when the trigger may go out, or when patience is over.

        Safe to cancel at any moment.

        Args:
            shot: where, in the plan's frame.
            patience_s: how long settling may take beyond the expected slew and the settle time.
            clear: None when nothing else keeps the trigger, else an event to wait for before asking again.
            coming_yaw_deg: yaws of the shots after this one.
        """
        expected_s = self._expected_slew_s(shot)
        commanded_s = self.clock.monotonic()
        asked = "vehicle"
        try:
            expected_s = max(expected_s, await self._turn([shot.yaw_deg, *coming_yaw_deg]))
            asked = "gimbal"
            await self._point(shot)
        except DeviceError as error:
            return NotSettled(code=asked, reason=str(error))
        if self.open_loop:
            await self.clock.sleep(1.5 * expected_s + self.settings.settle_s)
            while (blocker := clear()) is not None:
                await blocker.wait()
            await self.clock.sleep(self._interval_left_s())
            return Settled(commanded_s=commanded_s, settled_s=self.clock.monotonic())
        limits = SettleLimits(
            settle_s=self.settings.settle_s,
            max_rate_deg_s=self.settings.max_rate_deg_s,
            max_gap_s=self.settings.max_gap_s,
            told_rates=not self._nose_pans,
        )
        target = self._target(shot)
        tracker = SettleTracker(target=target, limits=limits)
        bound_s = expected_s + self.settings.settle_s + patience_s
        wait = _Wait(
            tracker=tracker,
            commanded_s=commanded_s,
            bound_s=bound_s,
            deadline_s=commanded_s + bound_s,
            newest_s=commanded_s,
        )
        done, settled_s = await until(self._overdue(wait), self._follow(wait, clear), f"settle shot {shot.index}")
        if done and settled_s is not None:
            return Settled(commanded_s=commanded_s, settled_s=settled_s)
        self._read(wait)
        why = tracker.problem
        if tracker.is_stale(self.clock.monotonic()):
            why = "the gimbal's attitude stream is silent"
        elif not why:
            why = "inside tolerance, but never for the whole settle time"
        return NotSettled(code="not_settled", reason=f"not settled after {bound_s:.1f} s: {why}")

    async def expose(self, shot: Shot, settled: Settled, *, interrupt: asyncio.Event) -> Exposure | NotSettled:
        """Trigger and judge; returns when the exposure has ended. Must not be cancelled half-way but at a hard stop.

        Args:
            shot: where the camera looks.
            settled: since when.
            interrupt: when it is set, no further photo of a bracket is taken.
        """
        captures: list[PendingCapture] = []
        stamps: list[float] = []
        failure, broken_off = "", False
        end_s = 0.0
        images_before = self.camera.image_count if isinstance(self.camera, PhotoMemory) else -1
        for number in range(1, self.settings.brackets + 1):
            if number > 1:
                left = self.clock.sleep(self._interval_left_s())
                await until(interrupt.wait(), left, f"bracket of shot {shot.index}")
                if broken_off := interrupt.is_set():
                    break
            try:
                capture = await within(self.clock, TRIGGER_BOUND_S, self.camera.trigger(), f"trigger {shot.index}")
            except (DeviceError, TimeoutError) as error:
                failure = f"photo {number} of {self.settings.brackets}: {error}"
                self._ready_s = self.clock.monotonic() + min(self.settings.interval_s, AFTER_REFUSAL_S)
                break
            # from the answer on, as the camera got the command before that: it counts its interval from then. Where
            # none comes, as over a cable, from the end of the command
            answered_s = capture.acknowledged_s
            now_s = self.clock.monotonic()
            self._ready_s = (now_s if math.isnan(answered_s) else answered_s) + self.settings.interval_s
            captures.append(capture)
            stamps.append(self.clock.time() - (self.clock.monotonic() - capture.commanded_s))
            end_s = await self._exposure_end(capture)
        if not captures:
            return NotSettled(code="trigger", reason=failure)
        return Exposure(
            captures=tuple(captures),
            verdict=await self._judged(shot, captures[0].commanded_s, end_s),
            trigger_utc_s=tuple(stamps),
            trigger_delay_s=captures[0].commanded_s - settled.settled_s,
            end_s=end_s,
            failure=failure,
            images_before=images_before,
            broken_off=broken_off,
        )

    async def _exposure_end(self, capture: PendingCapture) -> float:
        """Return when the exposure has ended, and when that was: proven by the camera, else bounded by its latency.

        A camera reports a photo after its shutter closed; a feedback pin tells when it opened.
        """
        bound_s = self.lag.bound_s + self.settings.exposure_s
        latest_s = capture.commanded_s + bound_s
        try:
            found = await capture.evidence(EvidenceLevel.FEEDBACK_PIN, bound_s)
        except DeviceError:
            found = None
        if found is not None and found.level >= EvidenceLevel.CAPTURE_MESSAGE:
            latest_s = min(latest_s, found.received_s)
        elif found is not None and found.level >= EvidenceLevel.FEEDBACK_PIN:
            latest_s = min(latest_s, found.received_s + self.settings.exposure_s)
        await self.clock.sleep(latest_s - self.clock.monotonic())
        return latest_s

    async def judge_date(
        self, shot: Shot, found: CaptureEvidence, commanded_s: float, exposure: Exposure
    ) -> WindowVerdict | None:
        """The verdict at the date of a photo; None if it has none, or lies inside the window that was judged.

        Args:
            shot: where the camera was to look.
            found: what is known of the photo.
            commanded_s: when its trigger went out.
            exposure: of the attempt.
        """
        if self.open_loop or not is_dated(found):
            return None
        start_s, end_s = window(found, commanded_s, self.settings)
        if exposure.captures[0].commanded_s <= start_s and end_s <= exposure.end_s:
            return None
        return await self._judged(shot, start_s, end_s)

    def _target(self, shot: Shot) -> Target:
        return Target(pitch_deg=shot.pitch_deg, yaw_deg=shot.yaw_deg, tolerance=self.settings.tolerance)

    async def _judged(self, shot: Shot, start_s: float, end_s: float) -> WindowVerdict:
        """The verdict on an exposure; what proves it may still be on its way on a busy computer."""
        verdict = self._judge(shot, start_s, end_s)
        if verdict.code != "no_samples":
            return verdict
        with suppress(TimeoutError):
            await within(self.clock, LATE_S, self.gimbal.feed.newer_than(end_s), f"samples of shot {shot.index}")
        return self._judge(shot, start_s, end_s)

    def _judge(self, shot: Shot, start_s: float, end_s: float) -> WindowVerdict:
        if self.open_loop:
            return WindowVerdict(ok=True, reason="", code="", samples=0, measured=None, errors=None)
        gap = self.settings.max_gap_s
        readings = self.poses.since(start_s - 2 * gap)
        return judge_window(readings, target=self._target(shot), start_s=start_s, end_s=end_s, max_gap_s=gap)

    @property
    def _nose_pans(self) -> bool:
        """Whether the camera looks where the vehicle's nose does."""
        return self.turner is not None and not gimbal_limits(self.gimbal, self.settings).pans

    async def _turn(self, yaws_deg: Sequence[float]) -> float:
        """Have the vehicle turned, where it pans; the seconds that this is expected to take."""
        turner = self.turner
        if turner is None:
            return 0.0
        yaws = [to_north(yaw, self.reference_yaw_north_deg) for yaw in yaws_deg]
        limits = gimbal_limits(self.gimbal, self.settings)
        return await self._insist(lambda: turner.begin(yaws, limits))

    async def _insist(self, command: Callable[[], Awaitable[T]]) -> T:
        """The result of a command that a device may refuse for the moment."""
        for _ in range(1, self.settings.device_tries):
            try:
                return await command()
            except DeviceError:
                await self.clock.sleep(0.2)
        return await command()

    async def _point(self, shot: Shot) -> None:
        yaw_north = None if self._nose_pans else to_north(shot.yaw_deg, self.reference_yaw_north_deg)
        await self._insist(lambda: self.gimbal.point(shot.pitch_deg, yaw_north))
        self._pointed = (shot.pitch_deg, shot.yaw_deg)

    def _expected_slew_s(self, shot: Shot) -> float:
        limits = gimbal_limits(self.gimbal, self.settings)
        start = self._pose_now() or self._pointed
        pitch, yaw = start or (shot.pitch_deg + 90.0, shot.yaw_deg + 180.0)
        return slew_time_s(
            limits, from_pitch_deg=pitch, from_yaw_deg=yaw, to_pitch_deg=shot.pitch_deg, to_yaw_deg=shot.yaw_deg
        )

    def _pose_now(self) -> tuple[float, float] | None:
        self.gimbal.feed.ingest()
        sample = self.gimbal.feed.latest
        if sample is None or self.open_loop:
            return None
        reading = read_pose(sample, self.gimbal.feed.vehicle_attitude_at(sample), self.reference_yaw_north_deg)
        if reading.rotation is None:
            return None
        yaw, pitch, _ = yaw_pitch_roll(reading.rotation)
        return float(pitch), float(yaw)

    def _interval_left_s(self) -> float:
        return max(0.0, self._ready_s - self.clock.monotonic())

    async def _follow(self, wait: _Wait, clear: Callable[[], asyncio.Event | None]) -> float:
        """Feed the tracker until the trigger may go out; returns when the last condition for it came true.

        Nothing is settled before the settle time is over since the newest sample that was not. Until then samples
        gather and are judged all at once: to wake up for each would cost more than all the rest of the slew.
        """
        tracker, free_s = wait.tracker, wait.commanded_s
        nose = self.turner if self._nose_pans else None
        rests_at_s = -math.inf if self.turner is None else self.turner.rests_at_s
        while True:
            await asyncio.sleep(0)  # a machine that cannot keep up with the samples must still hear everybody else
            self._read(wait, nose)
            now_s = self.clock.monotonic()
            if nose is not None and math.isnan(tracker.inside_since_s) and nose.is_off(now_s):
                await nose.correct()
            if not tracker.is_settled(now_s):
                await self._gather(wait, now_s, every_sample=nose is not None)
                continue
            blocker, left_s = clear(), max(self._interval_left_s(), rests_at_s - self.clock.monotonic())
            if blocker is None and left_s <= 0:
                return max(tracker.settled_at_s, free_s)
            wait.for_its_turn = True
            if blocker is not None:
                await blocker.wait()
                free_s = self.clock.monotonic()
            else:
                await self._sleep_most_of(left_s)
                free_s = self._ready_s
            wait.for_its_turn = False
            wait.deadline_s = max(wait.deadline_s, free_s + wait.bound_s)

    def _read(self, wait: _Wait, nose: HeadingController | None = None) -> None:
        """Feed the tracker with what has come."""
        readings = self.poses.since(wait.newest_s)
        if not readings:
            return
        wait.newest_s = readings[-1].time_s
        if nose is None:
            wait.tracker.add(*readings)
            return
        for reading in readings:
            wait.tracker.add(reading)
            if wait.tracker.error is not None:
                nose.note(reading.time_s, float(wait.tracker.error.yaw_deg))

    async def _gather(self, wait: _Wait, now_s: float, *, every_sample: bool) -> None:
        """Return when the pose may be settled, or with the next sample, if it could be at any moment."""
        settled_at_s = wait.tracker.settled_at_s
        if math.isnan(settled_at_s):
            settled_at_s = wait.newest_s + self.settings.settle_s
        left_s = settled_at_s - now_s
        if left_s > 0 and (not every_sample or left_s < LAST_SLEEP_S):
            await self._sleep_most_of(left_s)
        else:
            await self.gimbal.feed.newer_than(wait.newest_s)

    async def _sleep_most_of(self, left_s: float) -> None:
        """Return a little earlier, or at the end: what has gathered is judged before the moment that counts."""
        await self.clock.sleep(left_s - LAST_SLEEP_S if left_s > LAST_SLEEP_S else left_s)

    async def _overdue(self, wait: _Wait) -> None:
        """Return when patience is over; a pose that is settled and only waits for its turn has all the time."""
        while True:
            await self.clock.sleep(max(wait.deadline_s - self.clock.monotonic(), 0.05))
            now = self.clock.monotonic()
            if now >= wait.deadline_s and not wait.for_its_turn and not wait.tracker.is_settled(now):
                return


@dataclass(kw_only=True)
class _Wait:
    """The wait for one pose to settle; what keeps the trigger for other reasons moves its deadline.

    Attributes:
        newest_s: time of the newest sample that the tracker has.
        for_its_turn: the pose was settled, and something else keeps the trigger now.
    """

    tracker: SettleTracker
    commanded_s: float
    bound_s: float
    deadline_s: float
    newest_s: float
    for_its_turn: bool = False
