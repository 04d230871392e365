"""Where and when a panorama was taken, and the EXIF tags that say so.

Uploaders and photo maps read the position from EXIF, the viewers' direction from GPano; both are written from the same
figures. What the mission does not know is left out: a reader takes a wrong place for a right one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import PIL.ExifTags
import PIL.Image
from PIL.TiffImagePlugin import IFDRational

from panoexec.exports.model import ExportShot


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Place, direction and time of a panorama; NaN for what is not known.

    Attributes:
        latitude_deg: WGS 84, positive north.
        longitude_deg: WGS 84, positive east.
        altitude_m: above mean sea level.
        heading_deg: of the picture's middle column, clockwise from true north.
        time_utc_s: of the first photo.
    """

    latitude_deg: float = math.nan
    longitude_deg: float = math.nan
    altitude_m: float = math.nan
    heading_deg: float = math.nan
    time_utc_s: float = math.nan

    @property
    def has_position(self) -> bool:
        """Whether latitude and longitude are known and possible."""
        return abs(self.latitude_deg) <= 90.0 and abs(self.longitude_deg) <= 360.0


def place_of(document: Mapping[str, Any], shots: Sequence[ExportShot]) -> Place:
    """The place of a mission: as its manifest says, else that of its first photo with a position.

    Args:
        document: the manifest.
        shots: accepted photos.
    """
    heading = _number((document.get("reference") or {}).get("yaw_north_deg"))
    time_utc_s = min((shot.time_utc_s for shot in shots if math.isfinite(shot.time_utc_s)), default=math.nan)
    told = document.get("position") or {}
    places = [tuple(_number(told.get(key)) for key in ("latitude_deg", "longitude_deg", "altitude_m"))]
    places += [(shot.latitude_deg, shot.longitude_deg, shot.altitude_m) for shot in shots]
    for latitude, longitude, altitude in places:
        place = Place(
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude_m=altitude,
            heading_deg=heading,
            time_utc_s=time_utc_s,
        )
        if place.has_position:
            return place
    return Place(heading_deg=heading, time_utc_s=time_utc_s)


def exif_of(place: Place) -> PIL.Image.Exif:
    """The EXIF tags of a panorama."""
    base, ifd, gps = PIL.ExifTags.Base, PIL.ExifTags.IFD, PIL.ExifTags.GPS
    exif = PIL.Image.Exif()
    exif[base.Software] = "panoexec"
    exif[base.Orientation] = 1
    if math.isfinite(place.time_utc_s):
        moment = datetime.fromtimestamp(place.time_utc_s, UTC)
        stamp = moment.strftime("%Y:%m:%d %H:%M:%S")
        exif[base.DateTime] = stamp
        exif.get_ifd(ifd.Exif).update(
            {
                base.ExifVersion: b"0232",
                base.DateTimeOriginal: stamp,
                base.SubsecTimeOriginal: f"{moment.microsecond // 1000:03d}",
                base.OffsetTimeOriginal: "+00:00",
            }
        )
    tags: dict[int, Any] = {}
    if math.isfinite(place.heading_deg):
        tags[gps.GPSImgDirectionRef] = "T"
        # the same digits as PoseHeadingDegrees
        tags[gps.GPSImgDirection] = IFDRational(round(place.heading_deg % 360 * 1000) % 360_000, 1000)
    if place.has_position:
        east = (place.longitude_deg + 180.0) % 360.0 - 180.0
        tags[gps.GPSMapDatum] = "WGS-84"
        tags[gps.GPSLatitudeRef] = "N" if place.latitude_deg >= 0 else "S"
        tags[gps.GPSLatitude] = degrees_minutes_seconds(place.latitude_deg)
        tags[gps.GPSLongitudeRef] = "E" if east >= 0 else "W"
        tags[gps.GPSLongitude] = degrees_minutes_seconds(east)
        if math.isfinite(place.altitude_m):
            tags[gps.GPSAltitudeRef] = b"\x00" if place.altitude_m >= 0 else b"\x01"
            tags[gps.GPSAltitude] = IFDRational(round(abs(place.altitude_m) * 100), 100)
    if tags:
        exif.get_ifd(ifd.GPSInfo).update({gps.GPSVersionID: b"\x02\x03\x00\x00"} | tags)
    return exif


def degrees_minutes_seconds(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """An angle's size as EXIF has it; rounded to 0.0001 seconds of arc, some 3 mm, and never with 60 seconds."""
    total = round(abs(angle_deg) * 36_000_000)
    minutes, part = divmod(total, 600_000)
    return IFDRational(minutes // 60), IFDRational(minutes % 60), IFDRational(part, 10_000)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else math.nan
