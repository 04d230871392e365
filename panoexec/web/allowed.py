"""Which commands a vehicle can take now, and why not, in words for the button that is greyed.

The vehicle decides; this only says beforehand what it would answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from panoexec.web.values import table, text

_FLYING: Final = frozenset({"preflight", "capturing", "paused", "finishing"})
_NO_MISSION: Final = "no mission is under way"


def allowed(status: str, state: Mapping[str, Any] | None, *, link: bool, starting: bool = False) -> dict[str, str]:
    """For each command "" or the reason why it cannot be sent.

    Args:
        status: of the vehicle, `online`, `offline` or "".
        state: its newest state.
        link: whether the broker is connected.
        starting: whether a `start` of this server waits for its answer: its mission is being planned.
    """
    commands = ("plan", "start", "pause", "resume", "skip", "repeat", "finish", "abort")
    if not link:
        return dict.fromkeys(commands, "no connection to the broker")
    if status == "offline":
        return dict.fromkeys(commands, "the vehicle is offline")
    if not state:
        return dict.fromkeys(commands, "nothing was heard from the vehicle yet")
    now, resumable = text(state.get("state"), 20), text(state.get("resumable"), 40)
    flying = now in _FLYING
    idle = "" if flying else _NO_MISSION
    finishing = "the mission is finishing" if now == "finishing" else ""
    out = {
        "plan": "",
        "start": "a mission is under way"
        if flying
        else "a mission is being planned"
        if starting
        else _not_ready(state),
        "pause": idle or finishing or ("the mission is paused already" if now == "paused" else ""),
        "resume": "",
        "skip": idle or finishing,
        "repeat": idle or finishing,
        "finish": idle or finishing,
        "abort": "" if flying or resumable or starting else _NO_MISSION,
    }
    if flying and now != "paused":
        out["resume"] = "the mission is not paused"
    elif not flying and not resumable:
        out["resume"] = "no mission can be resumed"
    elif not flying:
        out["resume"] = _not_ready(state)
    return out


def _not_ready(state: Mapping[str, Any]) -> str:
    links = table(state.get("link"))
    missing = [name for name in ("autopilot", "gimbal", "camera") if table(links.get(name)).get("ok") is False]
    if missing:
        return f"{' and '.join(missing)} not ready"
    return ""
