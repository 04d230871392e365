"""A mission as its messages tell it, in the form in which the page draws it (`panoexec.web.protocol`)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

from panoexec.web.protocol import EVENT_LINES
from panoexec.web.values import number, numbers, pairs, quaternion, table, text, whole, wholes
from panoexec.web.words import line

_MOST_SHOTS: Final = 10_000
_MOST_ATTEMPTS: Final = 40
_MOST_SEEN: Final = 20_000


class Mission:
    """Folded from the plan and the events of one mission.

    Attributes:
        id: of the mission; "" while only a plan is known.
        name: for people.
        plan: what is told of its plan; None while it is not known.
        plan_is_guess: whether the plan came before the mission, and may be that of another one.
        gap: whether events were missed.
        last_seq: number of the newest event.
    """

    def __init__(self, mission_id: str) -> None:
        self.id = mission_id
        self.name = ""
        self.plan: dict[str, Any] | None = None
        self.plan_is_guess = False
        self.gap = False
        self.last_seq = 0
        self._shots: dict[int, dict[str, Any]] = {}
        self._content: dict[str, Any] | None = None
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENT_LINES)
        self._missed: set[int] = set()
        self._document: Mapping[str, Any] | None = None

    @property
    def shots(self) -> Mapping[int, dict[str, Any]]:
        """The shots by index."""
        return self._shots

    @property
    def content(self) -> dict[str, Any] | None:
        """See `panoexec.web.protocol`."""
        return self._content

    def document(self) -> dict[str, Any]:
        """See `panoexec.web.protocol`."""
        plan = self.plan or dict.fromkeys(("camera", "tolerance_deg", "band", "certificate", "estimate"))
        return {
            "id": self.id or None,
            "name": self.name,
            "notes": [],
            **plan,
            "shots": [shot for _, shot in sorted(self._shots.items())],
            "content": self._content,
            "events": list(self._events),
            "gap": self.gap,
        }

    def is_of(self, document: Mapping[str, Any]) -> bool:
        """Whether this is the plan that was taken."""
        return self._document == document

    def take_plan(self, document: Mapping[str, Any], *, guess: bool) -> None:
        """Take the payload of the topic `plan`; what attempts told stays."""
        self.plan, self._document, self.plan_is_guess = _plan(document), document, guess
        for index in [i for i, shot in self._shots.items() if not (shot["attempts"] or shot["patch"] or shot["url"])]:
            del self._shots[index]
        planned = document.get("shots")
        for item in planned[:_MOST_SHOTS] if isinstance(planned, list) else ():
            place, (pitch, yaw) = whole(table(item).get("index"), _MOST_SHOTS - 1), _target(table(item))
            if place is None or pitch is None or yaw is None:
                continue
            shot = self._shot(place)
            row = table(item).get("row")
            shot["row"] = row if isinstance(row, int) and not isinstance(row, bool) else -1
            shot["target"], shot["q"] = [pitch, yaw], quaternion(pitch, yaw)

    def take_event(self, event: Mapping[str, Any]) -> tuple[bool, dict[str, Any] | None, int | None]:
        """Fold an event.

        Returns:
            Whether it was new, its line in words (None for none), and the shot that it changed (None for none).
        """
        seq = whole(event.get("seq"), 10**9)
        if seq is None or not self._is_new(seq):
            return False, None, None
        kind = text(event.get("type"), 60)
        told = line(event)
        entry = None
        index = whole(event.get("shot"), _MOST_SHOTS - 1)
        if told is not None:
            entry = {"seq": seq, "time": text(event.get("time"), 40), "kind": kind, "level": told[0], "text": told[1]}
            entry |= {"shot": index, "attempt": whole(event.get("attempt")), "code": text(event.get("code"), 40)}
            self._events.append(entry)
        if kind == "content_judged":
            self._content = _content(event)
        elif kind in {"patch_planned", "bridge_planned"}:
            self._take_patches(event)
        elif kind.startswith(("shot_", "photo_")) and index is not None:
            _fold(self._shot(index), kind, event)
            return True, entry, index
        return True, entry, None

    def set_thumbnail(self, index: int, url: str) -> None:
        """Note where the picture of a shot is."""
        if index < _MOST_SHOTS:
            self._shot(index)["url"] = url

    def _is_new(self, seq: int) -> bool:
        """Whether the event was not heard yet; events may come twice, and again after a connection was lost."""
        if seq > self.last_seq:
            if seq > self.last_seq + 1:
                self.gap = True
                self._missed.update(range(self.last_seq + 1, min(seq, self.last_seq + _MOST_SEEN)))
            self.last_seq = seq
            return True
        if seq in self._missed:
            self._missed.discard(seq)
            self.gap = bool(self._missed)
            return True
        return False

    def _shot(self, index: int) -> dict[str, Any]:
        shot = self._shots.get(index)
        if shot is None:
            shot = {"i": index, "row": -1, "patch": False, "target": None, "q": None, "accepted": None, "reason": ""}
            shot |= {"url": None, "attempts": []}
            self._shots[index] = shot
        return shot

    def _take_patches(self, event: Mapping[str, Any]) -> None:
        indices = wholes(event.get("shots"))
        lists = [event.get(name) for name in ("pitch_deg", "yaw_deg")]
        for place, index in enumerate(indices):
            pitch, yaw = (number(one[place]) if isinstance(one, list) and len(one) > place else None for one in lists)
            if index >= _MOST_SHOTS or pitch is None or yaw is None:
                continue
            shot = self._shot(index)
            shot |= {"patch": True, "target": [pitch, yaw], "q": quaternion(pitch, yaw)}


def _half(camera: Mapping[str, Any], view: str, sensor: str) -> float | None:
    """Tangent of half a field of view, of what counts of an image: from the sensor where the plan does not say it."""
    angle = number(camera.get(view))
    if angle is not None and 0 < angle < 180:
        return number(math.tan(math.radians(angle / 2)), 7)
    size, focal = number(camera.get(sensor)), number(camera.get("focal_length_mm"))
    return number(size / (2 * focal), 7) if size and focal else None


def _plan(document: Mapping[str, Any]) -> dict[str, Any]:
    camera, constraints = table(document.get("camera")), table(document.get("constraints"))
    halves = [_half(camera, *names) for names in (("hfov_deg", "sensor_width_mm"), ("vfov_deg", "sensor_height_mm"))]
    tolerance = table(constraints.get("tolerance_deg"))
    masks = constraints.get("masks")
    notes = document.get("notes")
    return {
        "camera": None
        if None in halves
        else {
            "name": text(camera.get("name"), 80),
            "half_width": halves[0],
            "half_height": halves[1],
            "hfov_deg": number(camera.get("hfov_deg"), 2),
            "vfov_deg": number(camera.get("vfov_deg"), 2),
            "image_px": [whole(camera.get("image_width_px")), whole(camera.get("image_height_px"))],
        },
        "tolerance_deg": {axis: number(tolerance.get(axis)) for axis in ("pitch", "roll", "yaw")},
        "band": {
            "known": bool(constraints),
            "elevation": numbers(constraints.get("elevation_deg"), 2) or [-90.0, 90.0],
            "azimuth": numbers(constraints.get("azimuth_deg"), 2) or [-180.0, 180.0],
            "masks": [mask for one in masks[:100] if (mask := _mask(table(one)))] if isinstance(masks, list) else [],
            "overlap": [number(constraints.get("overlap_h")), number(constraints.get("overlap_v"))],
        },
        "certificate": dict(table(document.get("certificate"))) or None,
        "estimate": dict(table(document.get("estimate"))) or None,
        "notes": [text(note) for note in notes[:20]] if isinstance(notes, list) else [],
    }


def _mask(box: Mapping[str, Any]) -> list[float]:
    elevation, azimuth = numbers(box.get("elevation_deg"), 2), numbers(box.get("azimuth_deg"), 2)
    return elevation + azimuth if elevation and azimuth else []


def _target(item: Mapping[str, Any]) -> tuple[float | None, float | None]:
    return number(item.get("pitch_deg"), 6), number(item.get("yaw_deg"), 6)


def _content(event: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "edges": pairs(event.get("edges")),
        "bridges": pairs(event.get("bridges")),
        "groups": whole(event.get("groups")) or 0,
        **{name: wholes(event.get(name)) for name in ("geometry_only", "bad", "unchecked")},
    }


# --- attempts


def _fold(shot: dict[str, Any], kind: str, event: Mapping[str, Any]) -> None:
    shot["reason"] = text(event.get("reason")) if kind in {"shot_missed", "shot_skipped", "shot_deferred"} else ""
    count = whole(event.get("attempt"), 100_000)
    if kind in {"shot_skipped", "shot_missed", "shot_deferred", "shot_retaken"} or not count:
        return
    attempt = _attempt(shot, count)
    first_photo = (whole(event.get("photo")) or 1) == 1
    if kind == "shot_started":
        _start(shot, attempt, event)
    elif kind == "shot_exposed":
        _expose(attempt, event)
    elif kind == "shot_accepted":
        attempt |= {"verdict": "accepted", "by": text(event.get("by"), 20), "code": "", "reason": ""}
        shot["accepted"] = count
    elif kind in {"shot_rejected", "shot_revoked", "shot_interrupted"}:
        _reject(shot, attempt, event)
    elif kind == "photo_checked" and first_photo:
        attempt["content"] = _judged(event)
    elif kind == "photo_stored" and first_photo:
        attempt["file"] = text(event.get("file"), 200)
    photos = event.get("photos")
    if isinstance(photos, list) and photos:
        attempt["evidence"] = text(table(photos[0]).get("evidence"), 40)


def _start(shot: dict[str, Any], attempt: dict[str, Any], event: Mapping[str, Any]) -> None:
    pitch, yaw = _target(event)
    attempt["time"] = text(event.get("time"), 40)
    if shot["target"] is None and pitch is not None and yaw is not None:
        shot["target"], shot["q"] = [pitch, yaw], quaternion(pitch, yaw)


def _reject(shot: dict[str, Any], attempt: dict[str, Any], event: Mapping[str, Any]) -> None:
    attempt["verdict"] = "interrupted" if event.get("type") == "shot_interrupted" else "rejected"
    attempt |= {"by": "", "code": text(event.get("code"), 40), "reason": text(event.get("reason"))}
    if shot["accepted"] == attempt["n"]:
        before = [one["n"] for one in shot["attempts"] if one["verdict"] == "accepted"]
        shot["accepted"] = max(before, default=None)


def _attempt(shot: dict[str, Any], count: int) -> dict[str, Any]:
    attempts: list[dict[str, Any]] = shot["attempts"]
    known: dict[str, Any] | None = next((one for one in reversed(attempts) if one["n"] == count), None)
    if known is not None:
        return known
    new: dict[str, Any] = {"n": count, "verdict": "open", "by": "", "code": "", "reason": "", "error": None, "q": None}
    new |= {"pose": None, "evidence": "", "samples": None, "file": "", "time": "", "content": None}
    attempts.append(new)
    attempts.sort(key=lambda one: int(one["n"]))
    del attempts[:-_MOST_ATTEMPTS]
    return new


def _expose(attempt: dict[str, Any], event: Mapping[str, Any]) -> None:
    measured, errors = table(event.get("measured")), table(event.get("errors"))
    attempt["samples"] = whole(event.get("samples"))
    if measured:
        attempt["q"] = numbers(measured.get("q_wxyz"), 4, 6)
        attempt["pose"] = [number(measured.get(f"{axis}_deg")) for axis in ("pitch", "roll", "yaw")]
    if errors:
        attempt["error"] = [number(errors.get(f"{axis}_deg")) for axis in ("pitch", "roll", "yaw")]
    if event.get("pointing_ok") is False:
        attempt["reason"] = text(event.get("reason"))


def _judged(event: Mapping[str, Any]) -> dict[str, Any]:
    ties = event.get("ties")
    return {
        "verdict": text(event.get("verdict"), 30),
        "reason": text(event.get("reason")),
        "sharpness": number(event.get("sharpness")),
        "ties": [
            {
                "shot": whole(table(tie).get("shot")),
                "points": whole(table(tie).get("points")),
                "angle_deg": number(table(tie).get("angle_deg")),
            }
            for tie in (ties[:64] if isinstance(ties, list) else ())
        ],
    }
