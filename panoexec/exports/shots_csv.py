"""A CSV table of the shots: target, measured attitude, file."""

from __future__ import annotations

import csv
import io
import math
from datetime import UTC, datetime
from typing import Final

from panoexec.angles import wrap_180, yaw_pitch_roll, yaw_pitch_roll_321
from panoexec.exports.model import ExportSet, ExportShot

COLUMNS: Final = (
    "index", "row", "file", "bracket", "time_utc", "target_pitch_deg", "target_yaw_deg", "measured", "pitch_deg",
    "yaw_deg", "roll_deg", "yaw_north_deg", "q_w", "q_x", "q_y", "q_z", "hugin_y_deg", "hugin_p_deg", "hugin_r_deg",
    "error_pitch_deg", "error_roll_deg", "error_yaw_deg", "attempt", "evidence", "latitude_deg", "longitude_deg",
    "altitude_m",
)  # fmt: skip


def csv_text(exports: ExportSet) -> str:
    """The file's text: a header and one line per image; unknown values are empty.

    `yaw_deg` is in the plan's frame, `yaw_north_deg` from true north; pitch, yaw and roll are the gimbal's axes (3-1-2
    order), `hugin_*` the same attitude in Hugin's order.
    """
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for shot in exports.shots:
        writer.writerow(_line(exports, shot))
    return buffer.getvalue()


def _line(exports: ExportSet, shot: ExportShot) -> dict[str, object]:
    yaw, pitch, roll = (float(angle) for angle in yaw_pitch_roll(shot.rotation))
    hugin = dict(zip("ypr", yaw_pitch_roll_321(shot.rotation), strict=True))
    stamp = ""
    if math.isfinite(shot.time_utc_s):
        stamp = datetime.fromtimestamp(shot.time_utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {
        "index": shot.index,
        "row": shot.row,
        "file": shot.file_name,
        "bracket": shot.bracket,
        "time_utc": stamp,
        "target_pitch_deg": _number(shot.target_pitch_deg),
        "target_yaw_deg": _number(shot.target_yaw_deg),
        "measured": "yes" if shot.measured else "no",
        "pitch_deg": _number(pitch),
        "yaw_deg": _number(yaw),
        "roll_deg": _number(roll),
        "yaw_north_deg": _number(float(wrap_180(yaw + exports.reference_yaw_north_deg))),
        **{f"q_{axis}": _number(value, 9) for axis, value in zip("wxyz", shot.q_wxyz, strict=True)},
        **{f"hugin_{axis}_deg": _number(float(hugin[axis])) for axis in "ypr"},
        **{f"error_{axis}_deg": _number(shot.errors_deg.get(axis, math.nan)) for axis in ("pitch", "roll", "yaw")},
        "attempt": shot.attempt or "",
        "evidence": shot.evidence,
        "latitude_deg": _number(shot.latitude_deg, 8),
        "longitude_deg": _number(shot.longitude_deg, 8),
        "altitude_m": _number(shot.altitude_m, 2),
    }


def _number(value: float, digits: int = 4) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else ""
