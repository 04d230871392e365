"""Papywizard XML, version "c": read by PTGui, Autopano and Hugin.

The format has no file names: readers match its pictures and the photos by their order, so it contains only the accepted
photos, in the order in which they were taken.

Readers interpret yaw, pitch and roll as 3-2-1 angles; near the poles they are those of `polar_angles`.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Final
from xml.etree import ElementTree as ET

from panoexec.angles import wrap_180, yaw_pitch_roll_321
from panoexec.exports.model import ExportSet, ExportShot
from panoexec.exports.polar import polar_angles

_FULL_FRAME_DIAGONAL_MM: Final = math.hypot(36, 24)


def papywizard_angles(shot: ExportShot) -> tuple[float, float, float]:
    """Yaw, pitch and roll in the format's convention, degrees."""
    polar = polar_angles(shot.rotation)
    if polar is not None:
        return *polar, 0.0
    yaw, pitch, roll = (float(angle) for angle in yaw_pitch_roll_321(shot.rotation))
    return float(wrap_180(yaw)), pitch, roll


def papywizard_text(exports: ExportSet) -> str:
    """The file's text."""
    root = ET.Element("papywizard", version="c")
    _header(ET.SubElement(root, "header"), exports)
    shoot = ET.SubElement(root, "shoot")
    for number, shot in enumerate(exports.shots, start=1):
        picture = ET.SubElement(shoot, "pict", id=str(number), bracket=str(shot.bracket))
        _leaf(picture, "time", _stamp(shot.time_utc_s))
        yaw, pitch, roll = papywizard_angles(shot)
        ET.SubElement(picture, "position", yaw=_angle(yaw), pitch=_angle(pitch), roll=_angle(roll))
    ET.indent(root, "    ")
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _header(header: ET.Element, exports: ExportSet) -> None:
    camera, shots = exports.camera, exports.shots
    general = ET.SubElement(header, "general")
    _leaf(general, "title", exports.title)
    place = next((s for s in shots if math.isfinite(s.latitude_deg) and math.isfinite(s.longitude_deg)), None)
    _leaf(general, "gps", f"{place.latitude_deg:.7f}, {place.longitude_deg:.7f}" if place else "")
    _leaf(general, "comment", "panoexec: accepted photos only, in the order taken")
    shooting = ET.SubElement(header, "shooting", mode="preset")
    _leaf(shooting, "headOrientation", "up")
    # stored portrait pixels are upright: readers must not add a roll of 90°
    _leaf(shooting, "cameraOrientation", "portrait" if camera.is_portrait else "landscape")
    _leaf(shooting, "stabilizationDelay", f"{exports.settle_s:.1f}")
    times = [s.time_utc_s for s in shots if math.isfinite(s.time_utc_s)]
    _leaf(shooting, "startTime", _stamp(min(times, default=math.nan)))
    _leaf(shooting, "endTime", _stamp(max(times, default=math.nan)))
    body = ET.SubElement(header, "camera")
    _leaf(body, "timeValue", "0.0")
    brackets = max((s.bracket for s in shots), default=1)
    ET.SubElement(body, "bracketing", nbPicts=str(brackets), intent="exposure")
    long_mm = max(camera.sensor_width_mm, camera.sensor_height_mm)
    short_mm = min(camera.sensor_width_mm, camera.sensor_height_mm)
    crop = _FULL_FRAME_DIAGONAL_MM / math.hypot(long_mm, short_mm)
    ET.SubElement(body, "sensor", coef=f"{crop:.4f}", ratio="4:3" if long_mm / short_mm < 1.42 else "3:2")
    lens = ET.SubElement(header, "lens", type="rectilinear")
    _leaf(lens, "focal", f"{camera.focal_length_mm:g}")
    ET.SubElement(header, "preset", name=f"panoexec {camera.name}")


def _leaf(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _angle(angle_deg: float) -> str:
    return f"{round(angle_deg, 3) + 0.0:.3f}"


def _stamp(time_utc_s: float) -> str:
    if not math.isfinite(time_utc_s):
        return ""
    return datetime.fromtimestamp(time_utc_s, UTC).strftime("%Y-%m-%d_%Hh%Mm%Ss")
