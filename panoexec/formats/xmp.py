"""XMP packets: attitude of a photo, geometry of a stitched panorama; and lossless insertion into a JPEG.

Attitude is written in two forms, because readers expect one or the other:

* `drone-dji:Gimbal{Yaw,Pitch,Roll}Degree`: the camera's attitude in NED as yaw, pitch, roll in the 3-2-1 order, pitch
  -90 = nadir. `drone-dji:Flight…Degree` is the aircraft's.
* `Camera:{Yaw,Pitch,Roll}` (namespace of Pix4D): the same order, of a body whose z axis is the boresight and whose x
  axis is the image's top, so that all angles are 0 in a photo of the nadir with its top to the north.

Both are computed from the rotation matrix, not from angles of another sequence, and are exact at the poles too.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import yaw_pitch_roll_321

_NAMESPACES: Final = {
    "drone-dji": "http://www.dji.com/drone-dji/1.0/",
    "Camera": "http://pix4d.com/camera/1.0/",
    "GPano": "http://ns.google.com/photos/1.0/panorama/",
    "xmp": "http://ns.adobe.com/xap/1.0/",
    "tiff": "http://ns.adobe.com/tiff/1.0/",
}
_APP1: Final = 0xE1
_SIGNATURE: Final = b"http://ns.adobe.com/xap/1.0/\x00"


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Position of a photo: WGS 84, heights in metres; NaN or None if unknown."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    """Above mean sea level."""
    relative_altitude_m: float | None = None
    """Above the place of take-off."""


def attitude_properties(
    rotation: ArrayLike, *, flight_yaw_deg: float | None = None, position: Position | None = None
) -> dict[str, str]:
    """XMP properties of one photo.

    Args:
        rotation: camera-to-world rotation (3, 3).
        flight_yaw_deg: the aircraft's heading, if known.
        position: where it was taken, if known.
    """
    matrix = np.asarray(rotation, dtype=np.float64)
    properties = _angles("drone-dji:Gimbal{}Degree", matrix, "{:+.3f}")
    # the Pix4D body: x = image top = -(camera z), y = image right, z = boresight
    body = np.stack([-matrix[..., 2], matrix[..., 1], matrix[..., 0]], axis=-1)
    properties |= _angles("Camera:{}", body, "{:.3f}")
    if flight_yaw_deg is not None and np.isfinite(flight_yaw_deg):
        properties["drone-dji:FlightYawDegree"] = f"{flight_yaw_deg:+.2f}"
    if position is not None and np.isfinite(position.latitude_deg) and np.isfinite(position.longitude_deg):
        properties["drone-dji:GpsLatitude"] = f"{position.latitude_deg:.8f}"
        properties["drone-dji:GpsLongitude"] = f"{position.longitude_deg:.8f}"
        if np.isfinite(position.altitude_m):
            properties["drone-dji:AbsoluteAltitude"] = f"{position.altitude_m:+.2f}"
        if position.relative_altitude_m is not None and np.isfinite(position.relative_altitude_m):
            properties["drone-dji:RelativeAltitude"] = f"{position.relative_altitude_m:+.2f}"
    return properties


def _angles(name: str, matrix: ArrayLike, form: str) -> dict[str, str]:
    yaw, pitch, roll = yaw_pitch_roll_321(matrix)
    named = (("Yaw", yaw), ("Pitch", pitch), ("Roll", roll))
    # "+ 0.0" turns -0.0 into 0.0 after rounding
    return {name.format(axis): form.format(round(float(angle), 3) + 0.0) for axis, angle in named}


def gpano_properties(
    full_width_px: int,
    *,
    cropped_width_px: int | None = None,
    cropped_height_px: int | None = None,
    left_px: int = 0,
    top_px: int = 0,
    heading_deg: float = 0.0,
) -> dict[str, str]:
    """GPano properties of a stitched equirectangular picture (they belong to it, not to the photos).

    Args:
        full_width_px: width of the whole sphere; its height is half of it.
        cropped_width_px: width of the picture, if it shows a part of the sphere.
        cropped_height_px: likewise its height.
        left_px: column of the whole sphere where the picture starts.
        top_px: likewise its row.
        heading_deg: true heading of the middle column of the whole sphere; NaN if unknown.
    """
    height = full_width_px // 2
    heading = (
        {} if math.isnan(heading_deg) else {"GPano:PoseHeadingDegrees": f"{round(heading_deg % 360, 3) % 360:.3f}"}
    )
    return heading | {
        "GPano:ProjectionType": "equirectangular",
        "GPano:UsePanoramaViewer": "True",
        "GPano:FullPanoWidthPixels": str(full_width_px),
        "GPano:FullPanoHeightPixels": str(height),
        "GPano:CroppedAreaImageWidthPixels": str(cropped_width_px or full_width_px),
        "GPano:CroppedAreaImageHeightPixels": str(cropped_height_px or height),
        "GPano:CroppedAreaLeftPixels": str(left_px),
        "GPano:CroppedAreaTopPixels": str(top_px),
    }


def packet(properties: Mapping[str, str]) -> str:
    """The XMP packet (RDF/XML) of properties named `prefix:Name`, for a sidecar file or a JPEG.

    Raises:
        ValueError: an unknown prefix.
    """
    prefixes = {name.partition(":")[0] for name in properties}
    unknown = prefixes - _NAMESPACES.keys()
    if unknown:
        raise ValueError(f"unknown XMP prefix {sorted(unknown)}")
    lines = [
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>',
        '<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="panoexec">',
        ' <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">',
        '  <rdf:Description rdf:about=""',
        *(f'    xmlns:{prefix}="{_NAMESPACES[prefix]}"' for prefix in sorted(prefixes)),
        *(f"    {name}={quoteattr(value)}" for name, value in properties.items()),
        "  />",
        " </rdf:RDF>",
        "</x:xmpmeta>",
        '<?xpacket end="w"?>',
    ]
    return "\n".join(lines)


def with_xmp(jpeg: bytes, xmp: str) -> bytes:
    """A JPEG with its XMP packet set or replaced; all other bytes are unchanged.

    Args:
        jpeg: the file's content.
        xmp: the packet.

    Raises:
        ValueError: not a JPEG, a damaged one, or a packet too long for one segment (65502 bytes).
    """
    payload = _SIGNATURE + xmp.encode()
    if len(payload) + 2 > 0xFFFF:
        raise ValueError(f"XMP packet of {len(payload)} bytes does not fit into a JPEG segment")
    segment = struct.pack(">BBH", 0xFF, _APP1, len(payload) + 2) + payload
    if jpeg[:2] != b"\xff\xd8":
        raise ValueError("is not a JPEG")
    kept, position, place = [b"\xff\xd8"], 2, 1
    while True:
        if position + 4 > len(jpeg) or jpeg[position] != 0xFF:
            raise ValueError("is a broken JPEG")
        marker, length = jpeg[position + 1], int.from_bytes(jpeg[position + 2 : position + 4])
        if not 0xE0 <= marker <= 0xEF:
            break
        body = jpeg[position : position + 2 + length]
        if not (marker == _APP1 and body[4:].startswith(_SIGNATURE)):
            kept.append(body)
            # XMP follows JFIF and EXIF, which readers expect first
            if marker == 0xE0 or body[4:].startswith(b"Exif\x00"):
                place = len(kept)
        position += 2 + length
    kept.insert(place, segment)
    return b"".join(kept) + jpeg[position:]
