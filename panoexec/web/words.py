"""Events in words, one line each, for somebody who glances at the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from panoexec.mqtt.senders import received
from panoexec.web.values import number, text, whole, wholes

_CODES: Final = {
    "not_settled": "the gimbal did not settle",
    "pointing": "moved during the exposure",
    "no_samples": "too few attitudes during the exposure",
    "trigger": "the camera was not triggered",
    "evidence": "nothing proves the photo",
    "late_exposure": "exposed too late",
    "gimbal": "the gimbal was taken or lost",
    "foreign": "the photo is somebody else's",
    "stale": "the photo is an older one",
    "vehicle": "the vehicle was not ready",
    "crash": "the process ended before the verdict",
    "echo": "the gimbal repeats its commands instead of measuring",
}
_QUIET: Final = frozenset({"shot_started", "photo_identified", "mission_anchored", "gimbal_acquired", "content_judged"})
"""Seen on the map already, or of no use for an operator."""


def line(event: Mapping[str, Any]) -> tuple[str, str] | None:
    """Level (`info`, `good`, `warning`, `bad`) and text of an event; None for one that is not worth a line."""
    kind = text(event.get("type"), 60)
    if kind in _QUIET or not kind:
        return None
    special = _SPECIAL.get(kind)
    if special is not None:
        told: tuple[str, str] | None = special(event)
        return told
    reason = text(event.get("reason"))
    return "info", f"{kind.replace('_', ' ').capitalize()}{f': {reason}' if reason else ''}"


def _shot(event: Mapping[str, Any]) -> str:
    number_of = whole(event.get("shot"))
    return "Shot" if number_of is None else f"Shot {number_of}"


def _because(event: Mapping[str, Any], before: str = ": ") -> str:
    reason = text(event.get("reason")) or _CODES.get(text(event.get("code"), 40), "")
    return f"{before}{reason}" if reason else ""


def _started(event: Mapping[str, Any]) -> tuple[str, str]:
    total = whole(event.get("shots_total"))
    return "info", f"Mission {'continues' if event.get('resumed') is True else 'begins'}: {total} shots"


def _finished(event: Mapping[str, Any]) -> tuple[str, str]:
    state = text(event.get("state"), 20)
    level = {"complete": "good", "incomplete": "warning"}.get(state, "bad")
    missing = len(wholes(event.get("missing")))
    told = f"Mission {state}: {whole(event.get('accepted')) or 0} photos"
    told += f", {missing} shot{'s' if missing > 1 else ''} missing" if missing else ""
    return level, told + _because(event, ". ")


def _exposed(event: Mapping[str, Any]) -> tuple[str, str] | None:
    if event.get("pointing_ok") is not False:
        return None
    return "warning", f"{_shot(event)} outside of the tolerance{_because(event)}"


def _accepted(event: Mapping[str, Any]) -> tuple[str, str]:
    by = text(event.get("by"), 20)
    how = {"overlap": " (the overlaps hold)", "open_loop": " (without attitude feedback)"}.get(by, "")
    attempt = whole(event.get("attempt")) or 1
    return "good", f"{_shot(event)} taken{f' at attempt {attempt}' if attempt > 1 else ''}{how}"


def _checked(event: Mapping[str, Any]) -> tuple[str, str] | None:
    verdict = text(event.get("verdict"), 30)
    if verdict == "ok":
        return None
    level = "info" if verdict in {"geometry_only", "unchecked"} else "bad"
    return level, f"{_shot(event)}, content {verdict.replace('_', ' ')}{_because(event)}"


def _stored(event: Mapping[str, Any]) -> tuple[str, str]:
    size = number(event.get("size_bytes"))
    how_large = f", {size / 1e6:.1f} MB" if size else ""
    return "info", f"{_shot(event)}: photo stored{how_large}"


def _command(event: Mapping[str, Any]) -> tuple[str, str]:
    told = text(received(event))
    return "info", told[:1].upper() + told[1:]


def _paused(event: Mapping[str, Any]) -> tuple[str, str]:
    ending = "; continues by itself" if event.get("automatic") is True else ""
    return "warning", f"Paused{_because(event)}{ending}"


def _resumed(event: Mapping[str, Any]) -> tuple[str, str]:
    paused_s = number(event.get("paused_s"), 0)
    return "info", f"Continues{'' if paused_s is None else f' after {paused_s:.0f} s'}{_because(event)}"


def _preflight_failed(event: Mapping[str, Any]) -> tuple[str, str]:
    problems = event.get("problems")
    told = "; ".join(text(one) for one in problems[:8]) if isinstance(problems, list) else ""
    return "bad", f"Not ready: {told}"


def _patches(event: Mapping[str, Any]) -> tuple[str, str]:
    count = len(wholes(event.get("shots")))
    return "info", f"{count} shot{'s' if count != 1 else ''} added to close holes of the measured attitudes"


def _bridge(event: Mapping[str, Any]) -> tuple[str, str]:
    count = len(wholes(event.get("shots")))
    return "info", f"{count} shot{'s' if count != 1 else ''} added between photos that share too little to be tied"


def _simple(level: str, told: str) -> Any:
    return lambda event: (level, f"{told}{_because(event)}")


def _of_shot(level: str, told: str) -> Any:
    return lambda event: (level, f"{_shot(event)} {told}{_because(event)}")


_SPECIAL: Final[Mapping[str, Any]] = {
    "mission_started": _started,
    "mission_finished": _finished,
    "mission_paused": _paused,
    "mission_resumed": _resumed,
    "mission_finishing": _simple("info", "All shots taken; evidence and certificate are awaited"),
    "preflight_passed": _simple("info", "Preflight checks passed"),
    "preflight_failed": _preflight_failed,
    "command_received": _command,
    "warned": lambda event: ("warning", text(event.get("text")) or text(event.get("code"))),
    "gimbal_contradicted": lambda event: ("warning", text(event.get("text"))),
    "gimbal_released": lambda event: (
        ("info", "Gimbal released")
        if event.get("confirmed") is not False
        else ("warning", "Gimbal released, without confirmation")
    ),
    "patch_planned": _patches,
    "bridge_planned": _bridge,
    "shot_exposed": _exposed,
    "shot_accepted": _accepted,
    "shot_rejected": _of_shot("warning", "rejected"),
    "shot_revoked": _of_shot("bad", "taken back"),
    "shot_interrupted": _of_shot("info", "interrupted"),
    "shot_retaken": _of_shot("info", "is taken again"),
    "shot_deferred": _of_shot("info", "is taken again after the others"),
    "shot_missed": _of_shot("bad", "missed"),
    "shot_skipped": _of_shot("warning", "skipped"),
    "photo_stored": _stored,
    "photo_checked": _checked,
}
