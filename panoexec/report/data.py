"""The data of the page as one JSON document, rounded to the displayed precision; the page's scripts draw it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote

from panoexec import __version__
from panoexec.exports.from_manifest import camera_of
from panoexec.planning.model import Band
from panoexec.report.source import PhotoFile, Source, absence
from panoexec.report.timeline import AttemptTimes, Timeline, timeline

FORMAT = "panoexec.report/1"
_WHOLE_SPHERE = Band(elevation_min_deg=-90.0, elevation_max_deg=90.0)


def page_data(source: Source, *, made_utc_s: float) -> dict[str, Any]:
    """The page's data.

    Args:
        source: the mission.
        made_utc_s: time of the report.

    Raises:
        KeyError, TypeError, ValueError, ArithmeticError: the manifest is incomplete or invalid.
    """
    manifest = source.manifest
    times = timeline(source)
    by_attempt = {(item.shot, item.number): item for item in times.attempts}
    shots = [_shot(shot, source, by_attempt) for shot in manifest["shots"]]
    camera = manifest["camera"]
    optics = camera_of(manifest)
    tolerance = manifest.get("tolerance_deg") or _planned_tolerance(source)
    return {
        "format": FORMAT,
        "made": {"version": __version__, "time": datetime.fromtimestamp(made_utc_s, UTC).isoformat(timespec="seconds")},
        "mission": {
            "id": str(manifest.get("mission_id", source.folder.name)),
            "name": str(manifest.get("name") or ""),
            "state": str(manifest.get("state", "")),
            "reason": str(manifest.get("reason", "")),
            "times": manifest.get("times", {}),
            "vehicle": {str(key): _plain(value) for key, value in manifest.get("vehicle", {}).items()},
            "reference": manifest.get("reference", {}),
            "position": manifest.get("position", {}),
            "warnings": [str(text) for text in manifest.get("warnings", [])],
            "open_loop": bool(manifest.get("open_loop", False)),
        },
        "camera": {
            "name": str(camera["name"]),
            "half_width": _round(optics.half_width, 7),
            "half_height": _round(optics.half_height, 7),
            "hfov_deg": _round(float(camera.get("hfov_deg") or math.nan), 2),
            "vfov_deg": _round(float(camera.get("vfov_deg") or math.nan), 2),
            "image_px": [int(camera["image_width_px"]), int(camera["image_height_px"])],
        },
        "tolerance_deg": {axis: float(tolerance[axis]) for axis in ("pitch", "roll", "yaw")},
        "band": _band(source),
        "counts": manifest.get("counts") or _counts(shots),
        "certificate": manifest.get("certificate"),
        "parallax": _parallax(manifest.get("parallax")),
        "shots": shots,
        "reasons": _reasons(shots),
        "timeline": _timeline(times, source),
        "battery": _battery(source),
        "photos": {
            "accepted": len(source.photos),
            "usable": sum(1 for photo in source.photos.values() if not photo.problem),
            "absent": absence(source.photo_problems, photos=len(source.photos), folder=source.folder),
            "problems": [_photo_problem(index, photo) for index, photo in source.damaged],
        },
        "stitch": _stitch(source.stitch),
        "notes": list(source.notes),
    }


def _parallax(found: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The worst expected seam; the report does not list all pairs."""
    return None if not found else {"worst_px": found["worst_px"], "between": found["between"]}


def _planned_tolerance(source: Source) -> dict[str, float]:
    """The plan's tolerance, for manifests of other programs without one."""
    if source.plan is None or source.plan.constraints is None:
        raise KeyError("tolerance_deg")
    planned = source.plan.constraints.tolerance
    return {"pitch": planned.pitch_deg, "roll": planned.roll_deg, "yaw": planned.yaw_deg}


def _shot(shot: Mapping[str, Any], source: Source, times: Mapping[tuple[int, int], AttemptTimes]) -> dict[str, Any]:
    index = int(shot["index"])
    target = shot["target"]
    return {
        "i": index,
        "row": int(shot.get("row", 0)),
        "patch": bool(shot.get("patch", False)),
        "bridge": shot.get("bridge"),
        "status": str(shot.get("status") or ("accepted" if shot.get("accepted_attempt") else "pending")),
        "reason": str(shot.get("reason", "")),
        "target": [_round(target["pitch_deg"]), _round(target["yaw_deg"])],
        "q": _quaternion(target["quaternion"]),
        "accepted": shot.get("accepted_attempt"),
        "photo": _photo(source.photos.get(index)),
        "attempts": [_attempt(attempt, times.get((index, int(attempt["number"])))) for attempt in shot["attempts"]],
    }


def _attempt(attempt: Mapping[str, Any], times: AttemptTimes | None) -> dict[str, Any]:
    measured, error = attempt.get("measured"), attempt.get("error_deg")
    return {
        "n": int(attempt["number"]),
        "verdict": str(attempt.get("verdict", "")),
        "by": str(attempt.get("by", "")),
        "code": str(attempt.get("code", "")),
        "reason": str(attempt.get("reason", "")),
        "error": None if not error else [_round(error.get(axis), 4) for axis in ("pitch", "roll", "yaw")],
        "q": None if not measured else _quaternion(measured["quaternion"]),
        "pose": None if not measured else [_round(measured.get(f"{axis}_deg")) for axis in ("pitch", "roll", "yaw")],
        "evidence": str(attempt.get("evidence", "")),
        "samples": attempt.get("samples"),
        "times": None if times is None else _times(times),
    }


def _times(times: AttemptTimes) -> dict[str, float | None]:
    values = {
        "start": times.start_s, "slew": times.slew_s, "settle": times.settle_s, "wait": times.wait_s,
        "expose": times.expose_s, "after": times.after_s, "paused": times.paused_s, "limit": times.limit_s,
    }  # fmt: skip
    return {name: _round(value) for name, value in values.items()}


def _timeline(times: Timeline, source: Source) -> dict[str, Any]:
    totals = {
        "slew": sum(item.slew_s for item in times.attempts),
        "settle": sum(item.settle_s for item in times.attempts),
        "expose": sum(item.expose_s for item in times.attempts),
        "wait": sum(item.wait_s + item.after_s - item.paused_s for item in times.attempts),
        "paused": sum(item.paused_s for item in times.attempts),
    }
    return {
        "duration_s": _round(times.duration_s, 2),
        "limit_s": _round(times.limit_s, 2),
        "totals_s": {name: _round(value, 2) for name, value in totals.items()},
        "interval_s": source.settings.interval_s if source.settings else None,
        "lived_s": _round(times.lived_s, 2),
        "pace": _round(times.pace, 2),
        "simulated": source.simulated,
        "measured": bool(source.events),
    }


def _photo(photo: PhotoFile | None) -> dict[str, Any] | None:
    if photo is None:
        return None
    # only files in the mission directory are linked; a name is quoted because it may contain anything
    href = None if photo.problem else quote(photo.name, safe="/")
    return {"name": photo.name, "href": None if href is None else f"./{href}", "problem": photo.problem}


def _photo_problem(index: int, photo: PhotoFile) -> dict[str, Any]:
    return {"shot": index, "name": photo.name, "problem": photo.problem}


def _band(source: Source) -> dict[str, Any]:
    constraints = source.plan.constraints if source.plan else None
    band = constraints.band if constraints else _WHOLE_SPHERE
    boxes = constraints.masks if constraints else ()
    return {
        "known": constraints is not None,
        "elevation": [band.elevation_min_deg, band.elevation_max_deg],
        "azimuth": [band.azimuth_min_deg, band.azimuth_max_deg],
        "masks": [
            [box.elevation_min_deg, box.elevation_max_deg, box.azimuth_min_deg, box.azimuth_max_deg] for box in boxes
        ],
        "overlap": [constraints.overlap_h, constraints.overlap_v] if constraints else None,
    }


def _counts(shots: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts for manifests of other programs without them."""
    attempts = sum(len(shot["attempts"]) for shot in shots)
    done = [shot for shot in shots if shot["accepted"]]
    missing = [shot["i"] for shot in shots if not shot["accepted"]]
    tries = [sum(attempt["verdict"] != "interrupted" for attempt in shot["attempts"]) for shot in shots]
    retakes = sum(max(0, number - 1) for number in tries)
    return {
        "shots_total": len(shots),
        "shots_done": len(done),
        "attempts": attempts,
        "retakes": retakes,
        "missing": missing,
    }


def _reasons(shots: list[dict[str, Any]]) -> list[list[Any]]:
    codes = Counter(a["code"] or "other" for shot in shots for a in shot["attempts"] if a["verdict"] == "rejected")
    return [[code, count] for code, count in codes.most_common()]


def _battery(source: Source) -> dict[str, Any]:
    floor = source.settings.guards.battery_floor_frac if source.settings else None
    samples = []
    for item in source.manifest.get("battery", []):
        moment = datetime.fromisoformat(item["time"]).timestamp()
        samples.append((moment, float(item["charge_frac"])))
    origin = samples[0][0] if samples else 0.0
    return {"samples": [[_round(t - origin), _round(charge, 4)] for t, charge in samples], "floor": floor}


def _stitch(document: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if document is None:
        return None
    keys = ("completeness", "images", "left_out", "untied", "points", "rms_px", "hfov_deg", "canvas_px", "seconds")
    return {key: document.get(key) for key in keys}


def _quaternion(values: Sequence[Any]) -> list[float]:
    w, x, y, z = (round(float(value), 6) for value in values)
    return [w, x, y, z]


def _plain(value: object) -> object:
    return value if isinstance(value, str | int | float | bool) or value is None else str(value)


def _round(value: Any, digits: int = 3) -> float | None:
    """A finite number rounded; None for anything else."""
    return round(float(value), digits) if isinstance(value, int | float) and math.isfinite(value) else None
