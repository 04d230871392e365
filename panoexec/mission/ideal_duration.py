"""The ideal duration: the least time in which this gimbal and camera can take given shots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import Shot
from panoexec.planning.order.duration import slew_time_s


def ideal_step_durations_s(
    shots: Sequence[Shot],
    settings: MissionSettings,
    *,
    start: tuple[float, float] | None,
    exposure_s: float,
    lag_s: float = 0.0,
) -> list[float]:
    """The least seconds from each shot to the next, with one photo each.

    Args:
        shots: in shooting order.
        settings: rates, accelerations, settle time, interval.
        start: pitch and yaw before the first slew; None counts no slew for the first shot.
        exposure_s: exposure time of one photo.
        lag_s: shutter lag: from the camera's command to the opening of its shutter, if known.
    """
    limits = settings.gimbal
    if limits.turning is not None:
        limits = replace(limits, turning=replace(limits.turning, settle_s=0.0))
    at = start
    steps = []
    for number, shot in enumerate(shots):
        slew_s = 0.0
        if at is not None:
            slew_s = slew_time_s(
                limits,
                from_pitch_deg=at[0],
                from_yaw_deg=at[1],
                to_pitch_deg=shot.pitch_deg,
                to_yaw_deg=shot.yaw_deg,
            )
        least_s = slew_s + settings.settle_s + lag_s + exposure_s
        steps.append(least_s if number == 0 else max(least_s, settings.interval_s))
        at = (shot.pitch_deg, shot.yaw_deg)
    return steps
