"""One attempt at a shot: point, wait until settled, expose, judge every sample of the exposure."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from panoexec.angles import yaw_pitch_roll
from panoexec.clock import Clock
from panoexec.devices import Camera, EvidenceLevel, Gimbal, PendingCapture
from panoexec.errors import DeviceError
from panoexec.mission.attempt_result import Exposure, NotSettled, Offset, Settled
from panoexec.mission.dated_exposure import ShutterLag, is_dated
from panoexec.mission.exposure_judge import ExposureJudge
from panoexec.mission.pointing.echo import EchoWatch
from panoexec.mission.pointing.heading import HeadingController
from panoexec.mission.pointing.poses import PoseReader, read_pose, to_north
from panoexec.mission.pointing.rate_bias import RateBias
from panoexec.mission.pointing.tolerance_gate import (
    SettleLimits,
    SettleTracker,
)
from panoexec.mission.preflight import gimbal_limits
from panoexec.mission.protocols import MayFireLate, PacesPhotos, PhotoRecall, ReportsUndated
from panoexec.mission.settings import MissionSettings
from panoexec.mission.settle_wait import SettleWait
from panoexec.mission.slew_watch import SlewWatch
from panoexec.mission.waiting import until, within
from panoexec.planning.model import Shot
from panoexec.planning.order.duration import slew_time_s

T = TypeVar("T")
_OFFSET_AXES = ("pitch_deg", "roll_deg", "yaw_deg")

TRIGGER_TIMEOUT_S = 10.0
"""Longest wait for a trigger call; an adapter answers or times out long before."""
REFUSED_TRIGGER_DELAY_S = 0.5
"""Delay after a refused trigger, unless the camera's interval is shorter."""
INTERVAL_SLACK_S = 0.1
"""An interval of the camera that is longer than configured by less is not worth a warning."""
DEFERRED_SLACK_S = 0.1
"""How long after a deferred trigger was carried out its report may arrive."""
NOSE_HELD_S = 0.1
"""How long a nose must have been inside tolerance and slow: as long as its speed is measured over."""
SETTLED_AGAIN_S = 0.1
"""How long a gimbal that was settled must be inside tolerance after a gust: as long as its speed is measured over. A
longer wait makes no exposure better, and a mission in gusts half a second longer."""
FORESEE_GUST_S = 0.06
"""How far ahead a gimbal in gusts can be foreseen; what is beyond depends on gusts to come. In a model of 8 m/s (errors
of 0.035° rms, τ 0.1°) 4.5 % of exposures of 0.12 s are out of tolerance at some time instead of 7.4 %, and 2.6 % while
the shutter is open, for 20 ms more of waiting; to demand more of the moment costs more time than it saves."""
FORESEE_MARGIN_S = 0.05
"""The exposure, and the camera's report of it, may end so much later than expected."""


@dataclass(kw_only=True)
class Shooter:
    """Takes single shots: points, waits until settled, triggers and judges the exposure.

    Attributes:
        reference_yaw_north_deg: direction of the plan's yaw 0 from true north.
        open_loop: there is no attitude feedback; the pose is assumed after the slew time.
        heading_controller: turns the vehicle if the gimbal cannot pan far enough; None: the vehicle never turns.
        slews: what the slews so far have shown of the gimbal.
    """

    gimbal: Gimbal
    camera: Camera
    clock: Clock
    settings: MissionSettings
    reference_yaw_north_deg: float
    open_loop: bool
    heading_controller: HeadingController | None = None
    poses: PoseReader = field(init=False)
    lag: ShutterLag = field(init=False)
    slews: SlewWatch = field(init=False)
    judge: ExposureJudge = field(init=False)
    _rate_bias: RateBias = field(default_factory=RateBias, init=False)
    _ready_s: float = field(default=-math.inf, init=False)
    _pointed: tuple[float, float] | None = field(default=None, init=False)
    _warned_interval_s: float = field(default=0.0, init=False)
    _last_interval_s: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Begin to read the attitude stream."""
        self.lag = ShutterLag(self.settings.latency_s)
        self.poses = PoseReader(feed=self.gimbal.feed, reference_yaw_north_deg=self.reference_yaw_north_deg)
        self.slews = SlewWatch(poses=self.poses, echo=EchoWatch(self.gimbal.known.echo))
        self.judge = ExposureJudge(
            poses=self.poses,
            feed=self.gimbal.feed,
            camera=self.camera,
            clock=self.clock,
            settings=self.settings,
            slews=self.slews,
            lag=self.lag,
            open_loop=self.open_loop,
            vehicle_pans=lambda: self._vehicle_pans,
        )

    async def approach(
        self,
        shot: Shot,
        *,
        patience_s: float,
        clear: Callable[[], asyncio.Event | None],
        coming_yaw_deg: Sequence[float] = (),
    ) -> Settled | NotSettled:
        """Point at a shot; return when the trigger may be sent, or at the settle timeout.

        Safe to cancel at any time.

        Args:
            shot: the target, in the plan's frame.
            patience_s: settle timeout beyond the expected slew and the settle time.
            clear: returns None if nothing else blocks the trigger, else an event to await before it is called again.
            coming_yaw_deg: yaws of the following shots.
        """
        expected_s = self._expected_slew_s(shot)
        commanded_s = self.clock.monotonic()
        self.slews.begins()
        device = "vehicle"
        try:
            expected_s = max(expected_s, await self._turn([shot.yaw_deg, *coming_yaw_deg]))
            device = "gimbal"
            await self._point(shot)
        except DeviceError as error:
            return NotSettled(code=device, reason=str(error))
        if self.open_loop:
            await self.clock.sleep(1.5 * expected_s + self.settings.settle_s)
            while (blocker := clear()) is not None:
                await blocker.wait()
            await self.clock.sleep(self._interval_left_s())
            return Settled(commanded_s=commanded_s, settled_s=self.clock.monotonic())
        limits = self._settle_limits()
        target = self.judge.target(shot)
        self._rate_bias.interrupt()
        tracker = SettleTracker(target=target, limits=limits, bias=self._rate_bias)
        bound_s = expected_s + self.settings.settle_s + patience_s
        wait = SettleWait(
            poses=self.poses,
            feed=self.gimbal.feed,
            clock=self.clock,
            tracker=tracker,
            next_trigger_s=lambda: self._next_trigger_s,
            heading_controller=self.heading_controller,
            vehicle_pans=self._vehicle_pans,
            commanded_s=commanded_s,
            bound_s=bound_s,
            on_settled=lambda: self._is_verifiable(shot, commanded_s),
        )
        done, settled_s = await until(wait.timed_out(), wait.settled(clear), f"settle shot {shot.index}")
        settled = done and settled_s is not None
        if not settled:
            wait.read()
        foreign = self.slews.ended(shot, commanded_s, settled=settled, nose_since_s=self._nose_since_s(commanded_s))
        unverifiable = self.slews.unverifiable()
        if unverifiable is not None:
            return unverifiable
        if settled_s is not None:
            return Settled(commanded_s=commanded_s, settled_s=settled_s)
        return NotSettled(code="foreign", reason=foreign) if foreign else self._not_settled(tracker, bound_s)

    def _is_verifiable(self, shot: Shot, commanded_s: float) -> bool:
        """Whether an exposure can be verified, as the slew to it has shown too."""
        self.slews.seen(shot, commanded_s, yaw_follows=self._nose_since_s(commanded_s) is not None)
        return self.slews.unverifiable() is None

    def _settle_limits(self) -> SettleLimits:
        """What settled means: a nose never comes to rest, and is judged by what the exposure needs of it."""
        settings, nose = self.settings, self._vehicle_pans
        return SettleLimits(
            settle_s=min(settings.settle_s, NOSE_HELD_S) if nose else settings.settle_s,
            max_rate_deg_s=settings.max_rate_deg_s,
            max_gap_s=settings.max_gap_s if math.isnan(self.poses.interval_s) else self.judge.gap_s,
            foresee_s=self.lag.bound_s + settings.exposure_s + FORESEE_MARGIN_S if nose else 0.0,
            gust_s=0.0 if nose else FORESEE_GUST_S,
            again_s=math.inf if nose else SETTLED_AGAIN_S,
            use_reported_rate=not nose,
        )

    def _not_settled(self, tracker: SettleTracker, bound_s: float) -> NotSettled:
        why = tracker.problem
        if tracker.is_stale(self.clock.monotonic()):
            why = "the gimbal's attitude stream is silent"
        elif not why:
            why = "inside tolerance, but not for the whole settle time"
        off = tracker.error
        offset = None if off is None else Offset(**{axis: float(getattr(off, axis)) for axis in _OFFSET_AXES})
        return NotSettled(code="not_settled", reason=f"not settled after {bound_s:.1f} s: {why}", offset=offset)

    def _nose_since_s(self, commanded_s: float) -> float | None:
        """When the vehicle's turn is over, if its heading is the camera's yaw; else None."""
        if self.heading_controller is None or not self._vehicle_pans:
            return None
        return commanded_s + self.heading_controller.last_turn_s

    async def expose(self, shot: Shot, settled: Settled, *, interrupt: asyncio.Event) -> Exposure | NotSettled:
        """Trigger and judge; returns when the exposure has ended. Cancel it only for an immediate stop.

        Args:
            shot: the target.
            settled: the result of `approach`.
            interrupt: while it is set, no further photo of a bracket is taken.
        """
        captures: list[PendingCapture] = []
        stamps: list[float] = []
        fired_s: list[float] = []
        failure, broken_off = "", False
        end_s = 0.0
        images_before = self.camera.image_count if isinstance(self.camera, PhotoRecall) else -1
        for number in range(1, self.settings.brackets + 1):
            if number > 1:
                left = self.clock.sleep(self._interval_left_s())
                await until(interrupt.wait(), left, f"bracket of shot {shot.index}")
                if broken_off := interrupt.is_set():
                    break
            try:
                capture = await within(self.clock, TRIGGER_TIMEOUT_S, self.camera.trigger(), f"trigger {shot.index}")
            except (DeviceError, TimeoutError) as error:
                failure = f"photo {number} of {self.settings.brackets}: {error}"
                self._ready_s = self.clock.monotonic() + min(self.settings.interval_s, REFUSED_TRIGGER_DELAY_S)
                break
            # the camera's interval starts when it receives the command, at the latest when it answers; without an
            # acknowledgement (shutter cable) at the end of the command
            answered_s = capture.acknowledged_s
            now_s = self.clock.monotonic()
            self._ready_s = (now_s if math.isnan(answered_s) else answered_s) + self.settings.interval_s
            captures.append(capture)
            fired_s.append(await _fired(capture))
            stamps.append(self.clock.time() - (self.clock.monotonic() - capture.commanded_s))
            end_s = await self._exposure_end(capture, fired_s[-1])
        if not captures:
            return NotSettled(code="trigger", reason=failure)
        if not self.open_loop:
            await self.clock.sleep(self.slews.report_age_s)
        first = await captures[0].evidence(EvidenceLevel.COMMANDED, 0.0)
        start_s = captures[0].commanded_s
        if first.level >= EvidenceLevel.CAPTURE_MESSAGE and is_dated(first):
            # until a deferred trigger was carried out, nothing was exposed
            start_s = max(start_s, fired_s[0] - DEFERRED_SLACK_S)
        if len(captures) == 1:
            verdict, held = await self.judge.judge_opening(shot, captures[0], start_s, end_s)
        else:
            verdict, held = await self.judge.judge(shot, start_s, end_s), set()
        return Exposure(
            captures=tuple(captures),
            verdict=verdict,
            trigger_utc_s=tuple(stamps),
            trigger_delay_s=captures[0].commanded_s - settled.settled_s,
            start_s=start_s,
            end_s=end_s,
            failure=failure,
            images_before=images_before,
            broken_off=broken_off,
            held=held,
            by_opening=bool(held),
        )

    async def _exposure_end(self, capture: PendingCapture, fired_s: float) -> float:
        """Wait for the end of the exposure and return its time: reported by the camera, else the upper bound.

        A camera reports a photo after its shutter closed; a feedback pin signals that it opened.

        Args:
            capture: the photo.
            fired_s: when its trigger was carried out.
        """
        bound_s = self.lag.bound_s + self.settings.exposure_s
        if isinstance(self.camera, ReportsUndated):
            bound_s = max(bound_s, self.camera.undated_hold_s)
        latest_s = fired_s + bound_s
        level = EvidenceLevel.COUNTED if self.lag.until_report else EvidenceLevel.FEEDBACK_PIN
        try:
            found = await capture.evidence(level, latest_s - capture.commanded_s)
        except DeviceError:
            found = None
        if found is not None and found.level >= EvidenceLevel.CAPTURE_MESSAGE:
            latest_s = min(latest_s, found.received_s)
        elif found is not None and found.level >= EvidenceLevel.FEEDBACK_PIN:
            latest_s = min(latest_s, found.received_s + self.settings.exposure_s)
        elif found is not None and math.isfinite(found.exposed_s):
            latest_s = min(latest_s, max(fired_s, found.exposed_s) + self.settings.exposure_bound_s)
        await self.clock.sleep(latest_s - self.clock.monotonic())
        return latest_s

    @property
    def _vehicle_pans(self) -> bool:
        """Whether the vehicle's heading sets the camera's yaw: the gimbal has no pan axis in use."""
        return self.heading_controller is not None and not gimbal_limits(self.gimbal, self.settings).pans

    async def _turn(self, yaws_deg: Sequence[float]) -> float:
        """Turn the vehicle if needed; returns the expected duration, seconds."""
        heading_controller = self.heading_controller
        if heading_controller is None:
            return 0.0
        yaws = [to_north(yaw, self.reference_yaw_north_deg) for yaw in yaws_deg]
        limits = gimbal_limits(self.gimbal, self.settings)
        return await self._with_retries(lambda: heading_controller.begin(yaws, limits))

    async def _with_retries(self, command: Callable[[], Awaitable[T]]) -> T:
        """The result of a command; repeats it `device_tries` times while the device refuses it."""
        for _ in range(1, self.settings.device_tries):
            try:
                return await command()
            except DeviceError:
                await self.clock.sleep(0.2)
        return await command()

    async def _point(self, shot: Shot) -> None:
        yaw_north = None if self._vehicle_pans else to_north(shot.yaw_deg, self.reference_yaw_north_deg)
        await self._with_retries(lambda: self.gimbal.point(shot.pitch_deg, yaw_north))
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
        return max(0.0, self._next_trigger_s - self.clock.monotonic())

    def interval_warning(self) -> str:
        """A warning for the operator if the camera needs more time between two photos than configured.

        Once for a value, which must have stood the test of another photo.
        """
        known_s = self.camera.interval_s if isinstance(self.camera, PacesPhotos) else 0.0
        changed, self._last_interval_s = known_s != self._last_interval_s, known_s
        if changed or known_s <= max(self.settings.interval_s, self._warned_interval_s) + INTERVAL_SLACK_S:
            return ""
        self._warned_interval_s = known_s
        return (
            f"the camera needs {known_s:.1f} s between two photos, its interval is {self.settings.interval_s:g} s: "
            f"set [camera] interval_s to {math.ceil(10 * known_s) / 10:g}"
        )

    @property
    def _next_trigger_s(self) -> float:
        """When the next trigger may be sent: after the configured interval, or what is known of the camera's."""
        return max(self._ready_s, self.camera.ready_s) if isinstance(self.camera, PacesPhotos) else self._ready_s


async def _fired(capture: PendingCapture) -> float:
    """See `MayFireLate.fired`."""
    return await capture.fired() if isinstance(capture, MayFireLate) else capture.commanded_s
