"""The simulated camera's files: JPEGs with EXIF and XMP like those of real drone cameras."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import PIL.ExifTags
import PIL.Image
from PIL.TiffImagePlugin import IFDRational

from panoexec.angles import rotation_from_quaternion, yaw_pitch_roll
from panoexec.devices import Quaternion
from panoexec.files import write_atomically
from panoexec.formats.xmp import Position, attitude_properties, packet, with_xmp
from panoexec.sim.photos.landscape import Image


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoMetadata:
    """Metadata of a photo.

    Attributes:
        time_utc_s: start of the exposure, seconds since 1970 UTC.
        exposure_s: exposure time.
        focal_length_mm: real focal length.
        equivalent_focal_length_mm: 35 mm equivalent.
        q_wxyz: the camera's attitude (FRD to NED, true north) as its gimbal measured it.
        position: where it was taken, None without a fix.
        flight_yaw_deg: the aircraft's true heading, None if not known.
        make: the camera's maker.
        model: the camera's model.
        f_number: aperture.
        iso: sensitivity.
        manual_white_balance: not chosen by the camera.
    """

    time_utc_s: float
    exposure_s: float
    focal_length_mm: float
    equivalent_focal_length_mm: float
    q_wxyz: Quaternion
    position: Position | None = None
    flight_yaw_deg: float | None = None
    make: str = "panoexec"
    model: str = "simulated camera"
    f_number: float = 5.6
    iso: int = 100
    manual_white_balance: bool = False


def jpeg_bytes(image: Image, metadata: PhotoMetadata, *, quality: int = 90) -> bytes:
    """A photo as a JPEG file's content.

    Args:
        image: (h, w, 3) uint8 RGB.
        metadata: what goes into EXIF and XMP.
        quality: of the JPEG, 1 to 95.
    """
    rotation = rotation_from_quaternion(metadata.q_wxyz)
    buffer = io.BytesIO()
    PIL.Image.fromarray(np.ascontiguousarray(image)).save(
        buffer, "JPEG", quality=quality, exif=_exif(metadata, float(yaw_pitch_roll(rotation)[0]), image.shape)
    )
    properties = {"tiff:Make": metadata.make, "tiff:Model": metadata.model}
    properties |= attitude_properties(rotation, flight_yaw_deg=metadata.flight_yaw_deg, position=metadata.position)
    return with_xmp(buffer.getvalue(), packet(properties))


def padded(content: bytes, size: int) -> bytes:
    """A JPEG of at least that many bytes: comments before its picture fill the rest."""
    missing = size - len(content)
    if missing <= 0:
        return content
    comments = []
    while missing > 0:
        length = min(65533, max(0, missing - 4))  # a segment has its marker and its length beside its content
        comments.append(b"\xff\xfe" + (length + 2).to_bytes(2, "big") + bytes(length))
        missing -= length + 4
    at = 2
    while content[at + 1] != 0xDA:  # behind the headers, so that these are found in the file's first bytes
        at += 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    return content[:at] + b"".join(comments) + content[at:]


def write_jpeg(path: Path, image: Image, metadata: PhotoMetadata, *, quality: int = 90) -> int:
    """Write a photo atomically.

    Args:
        path: the file; its folder must exist.
        image: (h, w, 3) uint8 RGB.
        metadata: what goes into EXIF and XMP.
        quality: of the JPEG, 1 to 95.

    Returns:
        The file's size in bytes.

    Raises:
        UsageError: it cannot be written.
    """
    content = jpeg_bytes(image, metadata, quality=quality)
    # no fsync: a simulated photo need not survive a power loss
    write_atomically(path, content, sync=False)
    return len(content)


def _exif(metadata: PhotoMetadata, yaw_deg: float, shape: tuple[int, ...]) -> PIL.Image.Exif:
    base, ifd, gps = PIL.ExifTags.Base, PIL.ExifTags.IFD, PIL.ExifTags.GPS
    moment = datetime.fromtimestamp(metadata.time_utc_s, UTC)
    stamp, fraction = moment.strftime("%Y:%m:%d %H:%M:%S"), f"{moment.microsecond // 1000:03d}"
    exif = PIL.Image.Exif()
    exif[base.Make] = metadata.make
    exif[base.Model] = metadata.model
    exif[base.Software] = "panoexec"
    exif[base.Orientation] = 1
    exif[base.XResolution] = exif[base.YResolution] = IFDRational(72)
    exif[base.ResolutionUnit] = 2
    exif[base.YCbCrPositioning] = 1
    exif[base.DateTime] = stamp
    exif.get_ifd(ifd.Exif).update(
        {
            base.ExifVersion: b"0232",
            base.FlashPixVersion: b"0100",
            base.ExposureTime: _rational(metadata.exposure_s, 1_000_000),
            base.FNumber: _rational(metadata.f_number, 10),
            base.ISOSpeedRatings: metadata.iso,
            base.WhiteBalance: int(metadata.manual_white_balance),
            base.DateTimeOriginal: stamp,
            base.SubsecTimeOriginal: fraction,
            base.OffsetTimeOriginal: "+00:00",
            base.DateTimeDigitized: stamp,
            base.FocalLength: _rational(metadata.focal_length_mm, 1000),
            base.FocalLengthIn35mmFilm: max(1, round(metadata.equivalent_focal_length_mm)),
            base.ExifImageWidth: shape[1],
            base.ExifImageHeight: shape[0],
            base.ColorSpace: 1,
        }
    )
    where: dict[int, Any] = {
        gps.GPSVersionID: b"\x02\x03\x00\x00",
        gps.GPSImgDirectionRef: "T",
        gps.GPSImgDirection: _rational(yaw_deg % 360, 1000),
        gps.GPSDateStamp: moment.strftime("%Y:%m:%d"),
        gps.GPSTimeStamp: (
            IFDRational(moment.hour),
            IFDRational(moment.minute),
            IFDRational(moment.second * 1000 + moment.microsecond // 1000, 1000),
        ),
    }
    place = metadata.position
    if place is not None and math.isfinite(place.latitude_deg) and math.isfinite(place.longitude_deg):
        where[gps.GPSLatitudeRef] = "N" if place.latitude_deg >= 0 else "S"
        where[gps.GPSLatitude] = _degrees_minutes_seconds(place.latitude_deg)
        where[gps.GPSLongitudeRef] = "E" if place.longitude_deg >= 0 else "W"
        where[gps.GPSLongitude] = _degrees_minutes_seconds(place.longitude_deg)
        if math.isfinite(place.altitude_m):
            where[gps.GPSAltitudeRef] = b"\x00" if place.altitude_m >= 0 else b"\x01"
            where[gps.GPSAltitude] = _rational(abs(place.altitude_m), 100)
    exif.get_ifd(ifd.GPSInfo).update(where)
    return exif


def _rational(value: float, denominator: int) -> IFDRational:
    """The fraction nearest to a non-negative value with that denominator: EXIF has 32 bits for each part."""
    return IFDRational(round(value * denominator), denominator)


def _degrees_minutes_seconds(angle_deg: float) -> tuple[IFDRational, IFDRational, IFDRational]:
    """EXIF's form of a latitude or longitude without its sign, to 1e-5 seconds (0.3 mm)."""
    total = round(abs(angle_deg) * 3600 * 100_000)
    degrees, rest = divmod(total, 3600 * 100_000)
    minutes, seconds = divmod(rest, 60 * 100_000)
    return IFDRational(degrees), IFDRational(minutes), IFDRational(seconds, 100_000)
