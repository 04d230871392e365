"""Judges the attitudes of an exposure: from its trigger to its end, and at the date that the camera tells."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from panoexec.clock import Clock
from panoexec.devices import AttitudeFeed, Camera, CaptureEvidence, EvidenceLevel, PendingCapture
from panoexec.errors import DeviceError
from panoexec.mission.attempt_result import Exposure
from panoexec.mission.dated_exposure import ShutterLag, has_window, window
from panoexec.mission.pointing.fitted_pose import BESIDE_S, fitted
from panoexec.mission.pointing.poses import PoseReader
from panoexec.mission.pointing.tolerance_gate import Target, WindowVerdict, allowed_gap_s, judge_window, worst_errors
from panoexec.mission.pointing.unseen_motion import DENSE_GAP_S, HEADING_LAG_S
from panoexec.mission.protocols import ReportsPhotos
from panoexec.mission.settings import MissionSettings
from panoexec.mission.slew_watch import FRESH_MARGIN_S, SlewWatch
from panoexec.mission.waiting import within
from panoexec.planning.geometry.pose_error import PoseError, pose_error
from panoexec.planning.model import Shot, Tolerance

LATE_SAMPLES_S: Final = 0.5
"""How long to wait for delayed attitude samples of an exposure."""
_REPORT_S: Final = 0.3
"""How long after an exposure its report is waited for, if its date may decide."""
_BESIDE: Final = 0.25
_BESIDE_DEG: Final = 0.05
"""While the shutter was proven to be closed, a pose may be off by this part of τ more, at most by so many degrees: what
the camera told of its shutter decides no more than that."""


@dataclass(kw_only=True)
class ExposureJudge:
    """Verdicts on exposures.

    Attributes:
        poses: the readings.
        feed: the gimbal's reports.
        camera: whose photos are judged.
        clock: of the mission.
        settings: of the mission.
        slews: knows how old the gimbal's reports are.
        lag: of the camera's shutter.
        open_loop: there is no attitude feedback, and nothing to judge.
        vehicle_pans: whether the vehicle's heading sets the camera's yaw.
    """

    poses: PoseReader
    feed: AttitudeFeed
    camera: Camera
    clock: Clock
    settings: MissionSettings
    slews: SlewWatch
    lag: ShutterLag
    open_loop: bool
    vehicle_pans: Callable[[], bool]

    @property
    def gap_s(self) -> float:
        """The longest gap between samples that an exposure may have."""
        return allowed_gap_s(self.poses.interval_s, max_gap_s=self.settings.max_gap_s)

    def target(self, shot: Shot, *, tolerance: Tolerance | None = None) -> Target:
        """Where the camera is to look; with the mission's tolerance if none is given."""
        tolerance = tolerance or self.settings.tolerance
        return Target(pitch_deg=shot.pitch_deg, yaw_deg=shot.yaw_deg, tolerance=tolerance)

    async def judge(self, shot: Shot, start_s: float, end_s: float) -> WindowVerdict:
        """The verdict on an exposure; waits briefly for samples that are delayed on a busy computer."""
        end_s += self.slews.report_age_s
        verdict = self._judge(self.target(shot), start_s, end_s)
        if verdict.code != "no_samples":
            return verdict
        with suppress(TimeoutError):
            await within(self.clock, LATE_SAMPLES_S, self.feed.newer_than(end_s), f"samples of shot {shot.index}")
        return self._judge(self.target(shot), start_s, end_s)

    async def judge_opening(
        self, shot: Shot, capture: PendingCapture, start_s: float, end_s: float
    ) -> tuple[WindowVerdict, set[tuple[float, float]]]:
        """The verdict on an exposure that was out of tolerance, by when the shutter was open.

        A pose that is out of tolerance in a gust, between the trigger and the opening of the shutter, harms no photo.
        When the shutter was open must be proven (`ShutterLag.opening`), and otherwise the pose must be nearly right.

        Args:
            shot: where the camera was to look.
            capture: the trigger.
            start_s: of the whole exposure, on the mission's clock.
            end_s: its end.

        Returns:
            The verdict, and the intervals that it holds for besides the whole exposure.
        """
        whole = await self.judge(shot, start_s, end_s)
        dates = isinstance(self.camera, ReportsPhotos) and self.camera.reports_photos
        if whole.code != "pointing" or not dates:
            return whole, set()
        try:
            wait_s = self.clock.monotonic() + _REPORT_S - capture.commanded_s
            found = await capture.evidence(EvidenceLevel.CAPTURE_MESSAGE, wait_s)
        except DeviceError:
            return whole, set()
        opened = self.lag.opening(found, capture, self.settings.exposure_s)
        if opened is None:
            return whole, set()
        dated = window(found, capture.commanded_s, self.settings)
        near = self.target(shot, tolerance=_wider(self.settings.tolerance))
        age_s = self.slews.report_age_s  # of old reports, which `judge` waits for
        opening = opened[0], opened[1] + (0.0 if age_s else self.slews.fresh_age_s)
        near_ok = self._judge(near, min(start_s, dated[0]), max(end_s, dated[1]) + age_s).ok
        open_ = await self.judge(shot, *opening)
        if near_ok and open_.ok:
            return replace(open_, reason=f"{whole.reason} while the shutter was closed", proof="opening"), {dated}
        beside = opened[0] - BESIDE_S, opened[1] + FRESH_MARGIN_S + BESIDE_S
        curve = self._fitted(shot, opening, beside) if near_ok and open_.code == "pointing" and not age_s else None
        if curve is None:
            return whole, set()
        why = f"{whole.reason} by its noise: the readings together prove the pose"
        proven = replace(open_, ok=True, code="", reason=why, errors=worst_errors(curve), proof="curve")
        return proven, {dated}

    def _fitted(self, shot: Shot, opening: tuple[float, float], beside: tuple[float, float]) -> PoseError | None:
        """The errors of a curve that proves the pose of an opening (`fitted_pose`); None without one.

        Args:
            shot: where the camera was to look.
            opening: from when and until when readings show it.
            beside: the same of the readings that tell of it.
        """
        if self.vehicle_pans():
            return None
        readings = [reading for reading in self.poses.since(beside[0]) if reading.time_s <= max(beside[1], opening[1])]
        usable = [reading.rotation for reading in readings if reading.rotation is not None]
        gaps_s = [after.time_s - before.time_s for before, after in itertools.pairwise(readings)]
        if len(usable) < max(len(readings), 1) or max(gaps_s, default=0.0) > DENSE_GAP_S:
            return None
        errors = pose_error(shot.pitch_deg, shot.yaw_deg, np.stack(usable))
        return fitted(readings, errors, self.settings.tolerance, start_s=opening[0], end_s=opening[1])

    async def judge_date(
        self, shot: Shot, found: CaptureEvidence, commanded_s: float, exposure: Exposure
    ) -> WindowVerdict | None:
        """The verdict on the time in which a photo was exposed; None if that is unknown, or was judged already.

        Args:
            shot: where the camera was to look.
            found: what is known of the photo.
            commanded_s: when its trigger went out.
            exposure: of the attempt.
        """
        if self.open_loop or not has_window(found):
            return None
        start_s, end_s = window(found, commanded_s, self.settings)
        judged = exposure.start_s <= start_s and end_s <= exposure.end_s
        if judged or any(since_s <= start_s and end_s <= until_s for since_s, until_s in exposure.held):
            return None
        verdict = await self.judge(shot, start_s, end_s)
        if verdict.ok:
            exposure.held.add((start_s, end_s))
        return verdict

    def _judge(self, target: Target, start_s: float, end_s: float) -> WindowVerdict:
        if self.open_loop:
            return WindowVerdict(ok=True, reason="", code="", samples=0, measured=None, errors=None)
        return judge_window(
            self.poses.since(start_s - 2 * self.settings.max_gap_s),
            target=target,
            start_s=start_s,
            end_s=end_s,
            max_gap_s=self.gap_s,
            heading_lag_s=HEADING_LAG_S if self.vehicle_pans() else 0.0,
        )


def _wider(tolerance: Tolerance) -> Tolerance:
    def wider(limit_deg: float) -> float:
        return limit_deg + min(_BESIDE * limit_deg, _BESIDE_DEG)

    return Tolerance(
        pitch_deg=wider(tolerance.pitch_deg), roll_deg=wider(tolerance.roll_deg), yaw_deg=wider(tolerance.yaw_deg)
    )
