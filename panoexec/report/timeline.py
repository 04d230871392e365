"""The time of a mission by attempt and phase, compared with the physical limit.

Measured times (journal): the start of an attempt, when the last condition for the trigger was met, the end of the
exposure. The time before the trigger is split by computation: the slew is the least time that the gimbal's rates and
accelerations allow. If the camera's interval was the last condition, settling took the settle time and the rest is
waiting for the camera; else all the rest is settling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from panoexec.mission.ideal_duration import ideal_step_durations_s
from panoexec.mission.log import events as ev
from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import GimbalLimits, Shot
from panoexec.planning.order.duration import slew_time_s
from panoexec.report.source import Source

_WAITED_FOR_CAMERA_S: Final = 0.15
"""If the trigger followed the end of the camera's interval within this time, it had waited for the camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttemptTimes:
    """The times of one attempt, seconds of the mission.

    Attributes:
        shot, number: shot index and attempt number.
        start_s: since the start of the first attempt, without the time between processes.
        slew_s, settle_s, wait_s, expose_s: durations of the consecutive phases.
        after_s: from the exposure's end to the next attempt (evidence, pauses), 0 for the last.
        paused_s: part of `after_s` in which the mission was paused.
        limit_s: the physical limit: least time from the previous shot; 0 for a retake.
    """

    shot: int
    number: int
    start_s: float
    slew_s: float
    settle_s: float
    wait_s: float
    expose_s: float
    after_s: float
    paused_s: float
    limit_s: float

    @property
    def end_s(self) -> float:
        """When the exposure ended."""
        return self.start_s + self.slew_s + self.settle_s + self.wait_s + self.expose_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Timeline:
    """All attempts in the order of their starts.

    Attributes:
        attempts: their times.
        duration_s: from the first slew to the last exposure's end.
        limit_s: the physical limit for the same shots in the same order; NaN if unknown.
        lived_s: from the mission's first event to its last, without the time between processes; NaN if unknown.
        pace: seconds of the mission's clock per second of wall time; above 1 in an accelerated dry-run.
    """

    attempts: tuple[AttemptTimes, ...]
    duration_s: float
    limit_s: float
    lived_s: float = math.nan
    pace: float = 1.0


@dataclass(frozen=True, slots=True)
class _Begun:
    shot: int
    number: int
    entry: Mapping[str, Any]
    start_s: float


def timeline(source: Source) -> Timeline:
    """Compute the timeline from the manifest, with the journal's times if available."""
    axis = _Axis(source)
    begun = sorted(
        (
            _Begun(index, number, attempt, axis.start(index, number, began_utc_s))
            for shot in source.manifest["shots"]
            for attempt in shot["attempts"]
            for index, number in [(int(shot["index"]), int(attempt["number"]))]
            if math.isfinite(began_utc_s := _utc_s(attempt.get("started")))
        ),
        key=lambda item: item.start_s,
    )
    if not begun:
        return Timeline(attempts=(), duration_s=0.0, limit_s=math.nan, lived_s=axis.lived_s, pace=axis.pace)
    limits = _limits(begun, source.settings)
    origin = begun[0].start_s
    found: list[AttemptTimes] = []
    ready_s = -math.inf
    for number, item in enumerate(begun):
        before = begun[number - 1] if number else None
        following = begun[number + 1].start_s if number + 1 < len(begun) else None
        times, ready_s = _times(item, before, following, ready_s, axis, source.settings)
        found.append(_moved(times, origin, limits.get((item.shot, item.number), 0.0)))
    limit_s = sum(limits.values()) if limits else math.nan
    return Timeline(
        attempts=tuple(found), duration_s=found[-1].end_s, limit_s=limit_s, lived_s=axis.lived_s, pace=axis.pace
    )


def _times(  # noqa: PLR0917  (private)
    item: _Begun,
    before: _Begun | None,
    following: float | None,
    ready_s: float,
    axis: _Axis,
    settings: MissionSettings | None,
) -> tuple[AttemptTimes, float]:
    """The times of one attempt, and when the camera is ready again."""
    settle_least_s = settings.settle_s if settings else 0.3
    exposed = item.entry.get("slew_settle_s")
    ended = axis.ended.get((item.shot, item.number))
    until_s = following if following is not None else math.inf
    if exposed is None:
        # no photo: the whole attempt was pointing
        to_trigger_s = max(0.0, min(until_s, ended if ended is not None else until_s) - item.start_s)
        to_trigger_s = to_trigger_s if math.isfinite(to_trigger_s) else 0.0
        expose_s, trigger_s = 0.0, math.nan
    else:
        to_trigger_s = float(exposed)
        trigger_s = item.start_s + to_trigger_s + float(item.entry.get("trigger_delay_s") or 0.0)
        over_s = ended if ended is not None else trigger_s + (settings.exposure_bound_s if settings else 0.0)
        expose_s = max(0.0, min(over_s, until_s) - item.start_s - to_trigger_s)
    slew_s = min(to_trigger_s, _slew_s(item, before, settings, to_trigger_s - settle_least_s))
    rest_s = to_trigger_s - slew_s
    waited = abs(item.start_s + to_trigger_s - ready_s) < _WAITED_FOR_CAMERA_S
    wait_s = max(0.0, rest_s - settle_least_s) if waited else 0.0
    end_s = item.start_s + to_trigger_s + expose_s
    after_s = max(0.0, until_s - end_s) if math.isfinite(until_s) else 0.0
    times = AttemptTimes(
        shot=item.shot,
        number=item.number,
        start_s=item.start_s,
        slew_s=slew_s,
        settle_s=rest_s - wait_s,
        wait_s=wait_s,
        expose_s=expose_s,
        after_s=after_s,
        paused_s=min(after_s, axis.paused_s(end_s, end_s + after_s)),
        limit_s=0.0,
    )
    ready_after_s = trigger_s + (settings.interval_s if settings else 0.0)
    return times, ready_after_s if math.isfinite(ready_after_s) else ready_s


def _moved(times: AttemptTimes, origin_s: float, limit_s: float) -> AttemptTimes:
    return AttemptTimes(
        shot=times.shot, number=times.number, start_s=times.start_s - origin_s, slew_s=times.slew_s,
        settle_s=times.settle_s, wait_s=times.wait_s, expose_s=times.expose_s, after_s=times.after_s,
        paused_s=times.paused_s, limit_s=limit_s,
    )  # fmt: skip


def _slew_s(item: _Begun, before: _Begun | None, settings: MissionSettings | None, first_s: float) -> float:
    """The least time of the slew to an attempt; `first_s` for the first one, whose start pose is unknown."""
    if before is None:
        return max(0.0, first_s)
    here, there = item.entry["target"], before.entry["target"]
    return slew_time_s(
        settings.gimbal if settings else GimbalLimits(),
        from_pitch_deg=float(there["pitch_deg"]),
        from_yaw_deg=float(there["yaw_deg"]),
        to_pitch_deg=float(here["pitch_deg"]),
        to_yaw_deg=float(here["yaw_deg"]),
    )


def _limits(begun: Sequence[_Begun], settings: MissionSettings | None) -> dict[tuple[int, int], float]:
    """The physical limit of each shot, by its first attempt; the first slew counts as measured."""
    if settings is None:
        return {}
    first: dict[int, _Begun] = {}
    for item in begun:
        first.setdefault(item.shot, item)
    shots = [
        Shot(
            index=item.shot,
            row=0,
            pitch_deg=float(item.entry["target"]["pitch_deg"]),
            yaw_deg=float(item.entry["target"]["yaw_deg"]),
        )
        for item in first.values()
    ]
    steps = ideal_step_durations_s(shots, settings, start=None, exposure_s=settings.exposure_s)
    opening = begun[0].entry.get("slew_settle_s")
    if opening is not None:
        steps[0] += max(0.0, float(opening) - settings.settle_s)
    return {(item.shot, item.number): step for item, step in zip(first.values(), steps, strict=True)}


class _Axis:
    """The time axis: seconds of the mission's clock, without the gaps between processes.

    Attributes:
        begun, ended: when attempts (shot, number) began and their exposures ended, from the journal.
        lived_s, pace: see `Timeline`.
    """

    def __init__(self, source: Source) -> None:
        self._marks: list[tuple[float, float]] = []
        self._pauses: list[tuple[float, float]] = []
        self.begun: dict[tuple[int, int], float] = {}
        self.ended: dict[tuple[int, int], float] = {}
        self.lived_s = math.nan
        self.pace = 1.0
        paused_s, wall_s = math.nan, 0.0
        for event, now_s in self._lived(source.events):
            if self._marks and not isinstance(event, ev.MissionStarted):
                wall_s += event.time_utc_s - self._marks[-1][0]
            self._marks.append((event.time_utc_s, now_s))
            self.lived_s = now_s
            match event:
                case ev.MissionStarted():
                    paused_s = math.nan
                case ev.MissionPaused():
                    paused_s = now_s
                case ev.MissionResumed() if math.isfinite(paused_s):
                    self._pauses.append((paused_s, now_s))
                    paused_s = math.nan
                case ev.ShotStarted():
                    self.begun[event.shot, event.attempt] = now_s
                case ev.ShotExposed():
                    self.ended[event.shot, event.attempt] = now_s
                case ev.ShotRejected() | ev.ShotInterrupted():
                    self.ended.setdefault((event.shot, event.attempt), now_s)
                case _:
                    pass
        if source.simulated and wall_s > 0:
            self.pace = self.lived_s / wall_s

    @staticmethod
    def _lived(events: Sequence[ev.Event]) -> Iterator[tuple[ev.Event, float]]:
        """Each event with its time on the axis."""
        now_s = 0.0
        before: ev.Event | None = None
        for event in events:
            if before is not None and not (isinstance(event, ev.MissionStarted) and event.resumed):
                by_clock_s = event.clock_s - before.clock_s
                now_s += by_clock_s if math.isfinite(by_clock_s) else event.time_utc_s - before.time_utc_s
            yield event, now_s
            before = event

    def start(self, shot: int, number: int, utc_s: float) -> float:
        """When an attempt began: from the journal, else from the manifest's wall time."""
        known = self.begun.get((shot, number))
        if known is not None or not self._marks:
            return utc_s if known is None else known
        at_utc_s, at_s = next((mark for mark in reversed(self._marks) if mark[0] <= utc_s), self._marks[0])
        return at_s + (utc_s - at_utc_s) * self.pace

    def paused_s(self, start_s: float, end_s: float) -> float:
        """How long the mission was paused between two times of the axis."""
        return sum(max(0.0, min(end, end_s) - max(start, start_s)) for start, end in self._pauses)


def _utc_s(stamp: object) -> float:
    try:
        return datetime.fromisoformat(stamp).timestamp() if isinstance(stamp, str) else math.nan
    except ValueError:
        return math.nan
