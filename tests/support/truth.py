"""Compares a mission's manifest with the simulator's `truth.jsonl`: nothing that was accepted may be untrue.

The truth file has a line for each exposure: the true attitudes while the shutter was open, and the heading error, which
is in every report of vehicle and gimbal and in no photo. So a true yaw plus the heading error is comparable with what
the mission measured and aimed at.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from panoexec.angles import FloatArray, rotation
from panoexec.planning.geometry.pose_error import PoseError, pose_error

SLACK_DEG = 0.12
"""Encoder noise of a few samples: how far a true attitude may be outside a tolerance that all reports were inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposed:
    """One exposure as it really was.

    Attributes:
        number: running number in the file, from 0.
        index: the camera's image index; a camera that was reset uses one twice.
        file: name of the photo.
        start_s, end_s: simulated time of opening and closing of the shutter.
        yaw_roll_pitch_deg: (n, 3), from opening to closing, in the frame of the vehicle's and the gimbal's reports (yaw
            from the north that the compass believes in).
    """

    number: int
    index: int
    file: str
    start_s: float
    end_s: float
    yaw_roll_pitch_deg: FloatArray

    def error(self, pitch_deg: float, yaw_north_deg: float) -> PoseError:
        """Errors of its attitudes from a target, each (n,)."""
        yaw, roll, pitch = self.yaw_roll_pitch_deg.T
        return pose_error(pitch_deg, yaw_north_deg, rotation(yaw, pitch, roll))


def read_truth(path: Path) -> list[Exposed]:
    """The exposures of a truth file, in order."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    out: list[Exposed] = []
    for line in lines:
        if line["event"] != "exposure":
            continue
        angles = np.array(line["true_yaw_roll_pitch_deg"], dtype=np.float64)
        angles[:, 0] += line["heading_error_deg"]
        out.append(
            Exposed(
                number=len(out),
                index=line["image_index"],
                file=line["file"],
                start_s=line["sim_s"],
                end_s=line["end_s"],
                yaw_roll_pitch_deg=angles,
            )
        )
    return out


def untruths(mission: Path, truth: Path | None = None, *, slack_deg: float = SLACK_DEG) -> list[str]:
    """Every accepted photo that contradicts the truth, one line each; empty if nothing accepted is untrue.

    A photo that the manifest names by file or by index must have been exposed wholly within tolerance of the shot's
    target (plus `slack_deg`); no two accepted photos may be the same exposure. A photo of which only a count is known
    must have an exposure of its own within tolerance, in the order in which the photos were taken.

    Args:
        mission: the mission directory.
        truth: the truth file; None: that beside the mission's photos.
        slack_deg: see `SLACK_DEG`.
    """
    manifest = json.loads((mission / "manifest.json").read_text(encoding="utf-8"))
    exposures = read_truth(truth or mission / "images" / "truth.jsonl")
    limits_deg = [manifest["tolerance_deg"][axis] + slack_deg for axis in ("pitch", "roll", "yaw")]
    found: list[str] = []
    used: dict[int, str] = {}
    nameless: list[tuple[str, str, dict[str, Any]]] = []
    for name, target, attempt, photo in _accepted_photos(manifest):
        if not photo["file"] and photo["image_index"] < 0:
            nameless.append((attempt["started"], name, target))
            continue
        candidates = _named(photo, exposures)
        if not candidates:
            found.append(f"{name}: no exposure has the file {photo['file']!r} or the index {photo['image_index']}")
            continue
        fitting = [one for one in candidates if not _problem(one, target, limits_deg) and one.number not in used]
        one = (fitting or candidates)[0]
        if one.number in used:
            found.append(f"{name}: its photo is that of {used[one.number]}")
        elif problem := _problem(one, target, limits_deg):
            found.append(f"{name}: {problem}")
        used[one.number] = name
    return found + _unfounded(nameless, exposures, limits_deg, used)


def _accepted_photos(manifest: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]]:
    """Name, target, attempt and photo of each accepted photo."""
    for shot in manifest["shots"]:
        for attempt in shot["attempts"]:
            if attempt["number"] != shot["accepted_attempt"]:
                continue
            for photo in attempt["photos"]:
                name = f"shot {shot['index']}, attempt {attempt['number']}, photo {photo['number']}"
                yield name, shot["target"], attempt, photo


def _named(photo: dict[str, Any], exposures: Sequence[Exposed]) -> list[Exposed]:
    """The exposures that a photo's names can mean: by file if it has one, else by index."""
    file = str(photo["file"]).rsplit("/", 1)[-1]
    by_file = [one for one in exposures if file and one.file == file]
    return by_file or [one for one in exposures if one.index == photo["image_index"]]


def _problem(one: Exposed, target: dict[str, Any], limits_deg: Sequence[float]) -> str:
    error = one.error(target["pitch_deg"], target["yaw_north_deg"])
    worst = [float(np.abs(axis).max()) for axis in (error.pitch_deg, error.roll_deg, error.yaw_deg)]
    if all(value <= limit for value, limit in zip(worst, limits_deg, strict=True)):
        return ""
    boresight = float(error.boresight_deg.max())
    return f"photo {one.index} was exposed {boresight:.2f}° off (pitch, roll, yaw at worst {np.round(worst, 2)}°)"


def _unfounded(
    nameless: Sequence[tuple[str, str, dict[str, Any]]],
    exposures: Sequence[Exposed],
    limits_deg: Sequence[float],
    used: dict[int, str],
) -> list[str]:
    """Photos without a name for which there is no exposure of their own, each later than that of the one before."""
    found: list[str] = []
    after = -1
    for _, name, target in sorted(nameless, key=lambda item: item[0]):
        own = next(
            (
                one
                for one in exposures
                if one.number > after and one.number not in used and not _problem(one, target, limits_deg)
            ),
            None,
        )
        if own is None:
            found.append(f"{name}: nothing was exposed at its pose")
        else:
            after, used[own.number] = own.number, name
    return found
