"""Mission directories that a report has something to say of: a retake, times, a battery, a certificate."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from panoexec.sim.photos.scene import procedural_scene
from panoexec.store.directory import MissionDirectory
from tests.missions import BAND, CAMERA, ring_poses, write_mission

START_UTC_S = 1.79e9


def stamp(seconds: float) -> str:
    """A moment of the mission as a manifest writes it."""
    return datetime.fromtimestamp(START_UTC_S + seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def photographed(
    folder: Path, rows: Sequence[tuple[float, int]] = ((-90.0, 1), (-35.0, 6)), *, width_px: int = 160
) -> MissionDirectory:
    """A complete mission of 7 photos; the second shot needed a retake."""
    write_mission(folder, CAMERA, ring_poses(list(rows)), procedural_scene(1, 1024), width_px=width_px, band=BAND)
    directory = MissionDirectory(folder)
    edit(directory, _tell)
    return directory


def edit(directory: MissionDirectory, change: Any) -> None:
    """Change a manifest in place."""
    document = json.loads(directory.manifest.read_text(encoding="utf-8"))
    change(document)
    directory.manifest.write_text(json.dumps(document), encoding="utf-8")


def _tell(document: dict[str, Any]) -> None:
    for number, shot in enumerate(document["shots"]):
        (attempt,) = shot["attempts"]
        started = 2.0 * number + (2.0 if number > 1 else 0.0)
        attempt |= {
            "started": stamp(started),
            "target": shot["target"],
            "error_deg": {"pitch": 0.03, "roll": -0.02, "yaw": 0.2},
            "slew_settle_s": 1.5,
            "trigger_delay_s": 0.02,
        }
        shot["status"] = "accepted"
        shot["file"] = attempt["file"]
        if number == 1:
            rejected = attempt | {
                "verdict": "rejected", "code": "pointing", "reason": "pitch off by 2° (at most 0.1°)",
                "error_deg": {"pitch": 2.0, "roll": 0.01, "yaw": 0.1},
            }  # fmt: skip
            shot["attempts"] = [rejected, attempt | {"number": 2, "started": stamp(started + 2)}]
            shot["accepted_attempt"] = 2
    document |= {
        "reason": "every shot was accepted",
        "tolerance_deg": {"pitch": 0.1, "roll": 0.1, "yaw": 0.7},
        "times": {"started": stamp(0), "finished": stamp(20), "restarts": 0},
        "battery": [{"time": stamp(0), "charge_frac": 0.95}, {"time": stamp(18), "charge_frac": 0.9}],
        "certificate": {
            "certified": True, "images": 7, "min_overlap_h": 0.3, "min_overlap_v": 0.25, "worst_overlap_h": 0.3,
            "worst_overlap_v": 0.25, "uncovered_fraction": 0.0, "connected": True, "two_edge_connected": True,
            "failures": [], "holes": [], "weakest_h": [1, 2], "weakest_v": 0, "bridges": [],
        },
    }  # fmt: skip
