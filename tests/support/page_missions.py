"""Missions as the operator's page gets them (`panoexec.web.protocol`)."""

from __future__ import annotations

import copy
import io
from typing import Any

from panoexec.web.values import quaternion
from tests.support.page_server import MISSION, PageServer, state, vehicle

CAMERA = {
    "name": "dji-x5s-15mm", "half_width": 0.5766667, "half_height": 0.4333333, "hfov_deg": 59.94, "vfov_deg": 46.86,
    "image_px": [5280, 3956],
}  # fmt: skip
ROWS = ((-66.0, 4), (-28.0, 7), (11.0, 7))


def shot(index: int, pitch: float, yaw: float, **fields: Any) -> dict[str, Any]:
    """A shot that was not begun."""
    return {
        "i": index, "row": 0, "patch": False, "target": [pitch, yaw], "q": quaternion(pitch, yaw), "accepted": None,
        "reason": "", "url": None, "attempts": [],
    } | fields  # fmt: skip


def attempt(number: int, verdict: str, **fields: Any) -> dict[str, Any]:
    """An attempt."""
    return {
        "n": number, "verdict": verdict, "by": "tolerance", "code": "", "reason": "", "error": [0.02, -0.03, 0.2],
        "q": None, "pose": None, "evidence": "file_seen", "samples": 9, "file": "images/a.jpg",
        "time": f"2026-11-30T10:00:{number:02d}Z", "content": None,
    } | fields  # fmt: skip


def taken(one: dict[str, Any], *, ties: tuple[int, ...] = (), url: str | None = None, retaken: bool = False) -> None:
    """Accept a shot, at its second attempt if it was retaken."""
    content = {
        "verdict": "ok", "reason": "", "sharpness": 1.02,
        "ties": [{"shot": other, "points": 40, "angle_deg": 0.01} for other in ties],
    }  # fmt: skip
    first = [attempt(1, "rejected", code="pointing", reason="moved 0.4° during the exposure")] if retaken else []
    one["attempts"] = [*first, attempt(len(first) + 1, "accepted", content=content, q=one["q"])]
    one["accepted"], one["url"] = len(first) + 1, url


def grid(rows: tuple[tuple[float, int], ...] = ROWS) -> list[dict[str, Any]]:
    """Shots in rows of equal pitch."""
    found: list[dict[str, Any]] = []
    for pitch, count in rows:
        found += [shot(len(found) + k, pitch, (k * 360 / count + 180) % 360 - 180) for k in range(count)]
    return found


def mission(shots: list[dict[str, Any]], **fields: Any) -> dict[str, Any]:
    """A mission over the lower sphere."""
    return {
        "id": MISSION, "name": "chapel, west", "camera": CAMERA,
        "tolerance_deg": {"pitch": 0.1, "roll": 0.1, "yaw": 0.7},
        "band": {"known": True, "elevation": [-90, 30], "azimuth": [-180, 180], "masks": [], "overlap": [0.15, 0.15]},
        "certificate": None, "estimate": None, "notes": [], "shots": shots, "content": None, "events": [], "gap": False,
    } | fields  # fmt: skip


def flying(shots: list[dict[str, Any]], marks: str, **fields: Any) -> dict[str, Any]:
    """A vehicle in the middle of a mission."""
    done = sum(marks.count(letter) for letter in "dr")
    told = state(
        state="capturing", mission_id=MISSION, name="chapel, west", shots_total=len(shots), shots_done=done, eta_s=95.0,
        shots=" ".join(f"{letter}1" for letter in marks), retakes=marks.count("r"), battery_need_frac=0.34,
    )  # fmt: skip
    may = {"start": "a mission is under way", "resume": "the mission is not paused"}
    may |= dict.fromkeys(("plan", "pause", "skip", "repeat", "finish", "abort"), "")
    return vehicle(state=told, marks=marks, mission=mission(shots), may=may) | fields


EVENTS = [
    {
        "seq": 1,
        "time": "2026-11-30T10:00:01Z",
        "kind": "mission_started",
        "level": "info",
        "text": "Mission begins: 18 shots",
        "shot": None,
        "attempt": None,
    },
    {
        "seq": 2,
        "time": "2026-11-30T10:00:09Z",
        "kind": "shot_retaken",
        "level": "warning",
        "text": "Shot 1 is taken again: moved 0.4° during the exposure",
        "shot": 1,
        "attempt": 1,
    },
]


def midway(**fields: Any) -> dict[str, Any]:
    """Shot 0 done, 1 retaken, 2 current, 3 to be retaken, 4 missing, the rest planned."""
    shots = grid()
    taken(shots[0], ties=(1,), url=f"/thumbnails/drone/{MISSION}/0?n=a")
    taken(shots[1], ties=(0,), url=f"/thumbnails/drone/{MISSION}/1?n=a", retaken=True)
    shots[2]["attempts"] = [attempt(1, "open")]
    shots[3]["attempts"] = [attempt(1, "rejected", code="pointing", reason="yaw off by 0.9° (at most 0.7°)")]
    shots[4]["reason"] = "skipped by command"
    told = flying(shots, "drcam" + 13 * "t", **fields)
    told["mission"]["events"] = copy.deepcopy(EVENTS)
    return told


def plan_file(elevation: list[float], azimuth: list[float]) -> dict[str, Any]:
    """A plan of the shots that are in the band."""
    shots = [one for one in grid() if elevation[0] <= one["target"][0] <= elevation[1]]
    return {
        "format": "panoexec.plan/1",
        "method": "certified",
        "camera": {
            "name": "dji-x5s-15mm",
            "sensor_width_mm": 17.3,
            "sensor_height_mm": 13.0,
            "image_width_px": 5280,
            "image_height_px": 3956,
            "focal_length_mm": 15.0,
            "hfov_deg": 59.94,
            "vfov_deg": 46.86,
        },
        "constraints": {
            "overlap_h": 0.15,
            "overlap_v": 0.15,
            "elevation_deg": elevation,
            "azimuth_deg": azimuth,
            "tolerance_deg": {"pitch": 0.1, "roll": 0.1, "yaw": 0.7},
            "guarantee": "coverage",
            "masks": [],
        },
        "shots": [
            {"index": k, "row": 0, "pitch_deg": one["target"][0], "yaw_deg": one["target"][1]}
            for k, one in enumerate(shots)
        ],
    }


def planned(server: PageServer, request: dict[str, Any], *, certified: bool = True) -> dict[str, Any]:
    """Answer a request for a plan; returns the plan."""
    fields = request["fields"]
    plan = plan_file(fields.get("elevation_deg", [-90, 30]), fields.get("azimuth_deg", [-180, 180]))
    if "overlap" in fields:
        plan["constraints"] |= {"overlap_h": fields["overlap"], "overlap_v": fields["overlap"]}
    failures = [] if certified else ["a hole of 3° remains"]
    data = {
        "images": len(plan["shots"]),
        "rows": 3,
        "duration_s": 65.0,
        "certificate": {"certified": certified, "failures": failures},
        "camera": plan["camera"],
        "estimate": {"panorama_px": [28515, 14258]},
        "notes": [],
        "battery_need_frac": 0.12,
        "plan": plan,
    }
    server.say(
        {
            "type": "answer",
            "id": request["id"],
            "vehicle": "drone",
            "command": "plan",
            "stage": "done",
            "error": None,
            "data": data,
        }
    )
    return plan


def jpeg(width: int = 400, height: int = 300) -> bytes:
    """A picture."""
    import PIL.Image  # noqa: PLC0415 - an optional dependency

    out = io.BytesIO()
    PIL.Image.linear_gradient("L").resize((width, height)).convert("RGB").save(out, "JPEG", quality=80)
    return out.getvalue()
