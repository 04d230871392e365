"""What slews show of a gimbal: whether it measures, obeys and rests on target, and how old its reports are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from panoexec.mission.attempt_result import NotSettled
from panoexec.mission.pointing.echo import EchoWatch
from panoexec.mission.pointing.foreign import ForeignPointing
from panoexec.mission.pointing.nose_hold import NoseHold, motion_of
from panoexec.mission.pointing.poses import PoseReader
from panoexec.mission.pointing.steady_error import SteadyErrorWatch, error_at_rest
from panoexec.planning.model import Shot

FRESH_REPORT_S: Final = 0.03
"""Reports that show a slew within this time of its command, and their interval, are of the moment."""
OLD_REPORT_S: Final = 0.15
"""Those that do not within this time are old, however seldom they come."""
HELD_REPORT_S: Final = 0.4
"""Reports are taken for so old before a slew has shown it."""
REPORT_MARGIN_S: Final = 0.1
"""Reports may be so much older than a slew showed, if they are old."""
FRESH_MARGIN_S: Final = 0.02
"""The same of others."""
HELD_MARGIN_S: Final = 0.2
"""The same for reports that repeat, as those that are renewed ten times a second."""
OLDEST_REPORT_S: Final = 2.0
"""Longest wait for the reports of an exposure. Where a slew is seen later than that, no pose is verified."""
BEFORE_SLEW_S: Final = 1.5
"""Samples of so long before a slew are read, to know where it began: idle streams come once a second."""


@dataclass(kw_only=True)
class SlewWatch:
    """Judges the slews of one mission.

    Attributes:
        poses: the attitude reports as poses.
        echo: whether the gimbal's reports are measured.
        steady_error: whether the gimbal rests beside its commands.
        foreign: whether another station points the gimbal.
        nose: how well the vehicle holds its heading, where that is the camera's yaw.
    """

    poses: PoseReader
    echo: EchoWatch
    steady_error: SteadyErrorWatch = field(default_factory=SteadyErrorWatch)
    foreign: ForeignPointing = field(default_factory=ForeignPointing)
    nose: NoseHold = field(default_factory=NoseHold)
    _late_before_s: float = field(default=0.0, init=False)
    _late_at_slew_s: float = field(default=0.0, init=False)
    _seen_s: float = field(default=math.nan, init=False)

    def begins(self) -> None:
        """A slew is about to be commanded."""
        self._late_before_s = self.poses.late_s

    def seen(self, shot: Shot, commanded_s: float, *, yaw_follows: bool) -> None:
        """Learn from a slew whether the gimbal measures, and how old its reports are; each slew counts once.

        Args:
            shot: its target.
            commanded_s: when it was commanded.
            yaw_follows: the vehicle's heading is the camera's yaw.
        """
        if commanded_s == self._seen_s:
            return
        self._seen_s = commanded_s
        shows_age = self.echo.slew(
            self.poses.since(commanded_s - BEFORE_SLEW_S),
            commanded_s=commanded_s,
            pitch_deg=shot.pitch_deg,
            yaw_deg=shot.yaw_deg,
            yaw_follows=yaw_follows,
        )
        if shows_age:
            self._late_at_slew_s = self._late_before_s

    def ended(self, shot: Shot, commanded_s: float, *, settled: bool, nose_since_s: float | None) -> str:
        """Learn from the end of a slew whether the gimbal measures, and whether it rests where it was told.

        Args:
            shot: its target.
            commanded_s: when it was commanded.
            settled: whether it rested there until the trigger.
            nose_since_s: when the turn of the vehicle was over, if its heading is the camera's yaw; else None.

        Returns:
            Why another station must point the gimbal; "" if it need not.
        """
        self.seen(shot, commanded_s, yaw_follows=nose_since_s is not None)
        if settled:
            self.steady_error.settled()
            self.foreign.settled()
            self.nose.settled()
            return ""
        readings = self.poses.since(commanded_s - BEFORE_SLEW_S)
        pitch_deg, yaw_deg = shot.pitch_deg, shot.yaw_deg
        if nose_since_s is not None:
            self.nose.failed(motion_of(readings, since_s=nose_since_s), shot=shot.index, yaw_deg=yaw_deg)
            return ""
        foreign = self.foreign.failed(readings, commanded_s=commanded_s, pitch_deg=pitch_deg, yaw_deg=yaw_deg)
        if foreign:
            return foreign
        at_rest = error_at_rest(readings, pitch_deg=pitch_deg, yaw_deg=yaw_deg)
        self.steady_error.failed(at_rest, pitch_deg=pitch_deg, yaw_deg=yaw_deg)
        return ""

    def unverifiable(self) -> NotSettled | None:
        """Why no exposure can be verified by the gimbal's reports, as its slews have shown; None if it can."""
        if self.echo.reason:
            return NotSettled(code="echo", reason=f"the gimbal's reports are no feedback: {self.echo.reason}")
        if self.echo.delay_s > OLDEST_REPORT_S:
            shown = f"the gimbal's reports show a slew {self.echo.delay_s:.1f} s after its command"
        elif self._grown_s > OLDEST_REPORT_S:
            shown = f"the gimbal's reports are {self._grown_s:.1f} s later than they were at the last slew"
        else:
            return None
        return NotSettled(code="stale", reason=f"{shown}: no exposure can be verified by them")

    @property
    def _grown_s(self) -> float:
        """By how much the gimbal's reports became older since a slew last showed their age."""
        return max(0.0, self.poses.late_s - self._late_at_slew_s)

    @property
    def report_age_s(self) -> float:
        """How old the gimbal's reports may be, by its slews; 0 if they are of the moment.

        What happened during an exposure is seen in the reports of so much later.
        """
        delay_s = self.echo.longest_delay_s
        if math.isnan(delay_s):
            return min(HELD_REPORT_S + self._grown_s, OLDEST_REPORT_S)
        delay_s += self._grown_s
        if self.poses.holds:
            return min(delay_s + HELD_MARGIN_S, OLDEST_REPORT_S)
        if delay_s > OLD_REPORT_S:
            return min(delay_s + REPORT_MARGIN_S, OLDEST_REPORT_S)
        interval_s = 0.0 if math.isnan(self.poses.interval_s) else self.poses.interval_s
        return delay_s + FRESH_MARGIN_S if delay_s - interval_s > FRESH_REPORT_S else 0.0

    @property
    def fresh_age_s(self) -> float:
        """How old reports of the moment may be: what slews have shown, at least `FRESH_MARGIN_S`."""
        delay_s = self.echo.longest_delay_s
        return FRESH_MARGIN_S if math.isnan(delay_s) else max(delay_s + self._grown_s, FRESH_MARGIN_S)
