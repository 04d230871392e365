"""Where the exposure of a panorama is metered: at its brightest part, away from the sun.

A panorama is exposed for its brightest part, because what is too bright is lost, and the rest can be lifted. That is
the sky of its highest row, as near to the sun as the sun does not shine into the picture.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Final

from panoexec.errors import DeviceError
from panoexec.formats.photo_settings import PhotoExif
from panoexec.mission.attempt import Shooter
from panoexec.mission.context import MissionContext
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.protocols import MetersExposure
from panoexec.planning.model import Shot

AWAY_DEG: Final = 60.0
"""Least angle between the sun and where the exposure is metered."""
_ROW_DEG: Final = 5.0
_UP_DEG: Final = -0.8
"""The sun shines above this elevation: refraction, and its radius."""


def sun_direction(time_utc_s: float, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Azimuth from true north and elevation of the sun, degrees, within some 0.1° (no refraction).

    Source: the low-precision formulae of the Astronomical Almanac.

    Args:
        time_utc_s: seconds since 1970.
        latitude_deg: north is positive.
        longitude_deg: east is positive.
    """
    days = time_utc_s / 86400.0 - 10957.5  # since J2000.0
    mean_deg = (280.460 + 0.9856474 * days) % 360.0
    anomaly = math.radians((357.528 + 0.9856003 * days) % 360.0)
    ecliptic = math.radians(mean_deg + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    tilt = math.radians(23.439 - 4e-7 * days)
    right_ascension = math.atan2(math.cos(tilt) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(tilt) * math.sin(ecliptic))
    sidereal_deg = (280.46062 + 360.98564737 * days + longitude_deg) % 360.0
    hour, latitude = math.radians(sidereal_deg) - right_ascension, math.radians(latitude_deg)
    up = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(hour)
    east = -math.cos(declination) * math.sin(hour)
    north = math.cos(latitude) * math.sin(declination) - math.sin(latitude) * math.cos(declination) * math.cos(hour)
    return math.degrees(math.atan2(east, north)) % 360.0, math.degrees(math.asin(max(-1.0, min(1.0, up))))


def where_to_meter(shots: Sequence[Shot], *, reference_yaw_north_deg: float, sun_deg: tuple[float, float]) -> Shot:
    """The shot at which the exposure is metered.

    Args:
        shots: of the plan, at least one.
        reference_yaw_north_deg: direction of the plan's yaw 0 from true north.
        sun_deg: azimuth and elevation of the sun; NaN if unknown.
    """
    top_deg = max(shot.pitch_deg for shot in shots)
    row = [shot for shot in shots if shot.pitch_deg >= top_deg - _ROW_DEG]
    azimuth_deg, elevation_deg = sun_deg
    if not elevation_deg > _UP_DEG:  # unknown, or below the horizon
        return row[0]
    apart = [
        (_angle_deg(shot.yaw_deg + reference_yaw_north_deg, shot.pitch_deg, azimuth_deg, elevation_deg), shot)
        for shot in row
    ]
    away = [one for one in apart if one[0] >= AWAY_DEG]
    return min(away, key=lambda one: one[0])[1] if away else max(apart, key=lambda one: one[0])[1]


def _angle_deg(azimuth_a: float, elevation_a: float, azimuth_b: float, elevation_b: float) -> float:
    a, b, turn = math.radians(elevation_a), math.radians(elevation_b), math.radians(azimuth_a - azimuth_b)
    cosine = math.sin(a) * math.sin(b) + math.cos(a) * math.cos(b) * math.cos(turn)
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def sun_over(record: MissionRecord, time_utc_s: float) -> tuple[float, float]:
    """The sun over the mission's position; NaN without one, or with a clock that cannot be right."""
    latitude_deg, longitude_deg, _ = record.origin
    if math.isnan(latitude_deg) or time_utc_s < datetime(2024, 1, 1, tzinfo=UTC).timestamp():
        return math.nan, math.nan
    return sun_direction(time_utc_s, latitude_deg, longitude_deg)


async def meter_exposure(context: MissionContext, shooter: Shooter) -> str:
    """Have the camera keep one exposure from now on; returns what prevents that, "" if nothing does.

    Args:
        context: of a mission whose gimbal is acquired.
        shooter: points the camera.
    """
    camera, record = context.camera, context.record
    if not isinstance(camera, MetersExposure) or not camera.needs_metering:
        return ""
    try:
        known = first_settings(record)
        if known is None:
            shots = [one.shot for one in record.shots.values()]
            reference_deg = record.reference_yaw_north_deg
            sun_deg = sun_over(record, context.clock.time())
            shot = where_to_meter(shots, reference_yaw_north_deg=reference_deg, sun_deg=sun_deg)
            # it need not settle there to be metered
            await shooter.approach(shot, patience_s=context.settings.patience_s, clear=lambda: None)
        problem = await camera.meter(known)
        if known is None and not problem:  # it took a photo
            await context.clock.sleep(context.settings.interval_s)
    except DeviceError as error:
        problem = f"the exposure cannot be metered: {error}"
    return problem


def first_settings(record: MissionRecord) -> PhotoExif | None:
    """The settings of the mission's first stored photo, which a mission that goes on must keep; None without one."""
    return min(_told(record), key=lambda one: one[0], default=(0, None))[1]


def _told(record: MissionRecord) -> Iterable[tuple[int, PhotoExif]]:
    for shot in record.shots.values():
        for attempt in shot.attempts:
            for stored in attempt.stored.values():
                if stored.exif is not None and stored.exif.exposure_s is not None:
                    yield stored.seq, stored.exif
