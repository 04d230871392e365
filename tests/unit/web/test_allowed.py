"""What is greyed, and why: every state of a mission, and what is missing."""

from __future__ import annotations

from typing import Any

import pytest

from panoexec.mission.log.states import MissionState
from panoexec.web.allowed import allowed
from panoexec.web.fleet import unfolded

LINKS = {name: {"ok": True, "age_s": 0.1} for name in ("autopilot", "gimbal", "camera")}


def possible(state: str, *, resumable: str | None = None, links: dict[str, Any] = LINKS, **more: Any) -> set[str]:
    document = {"state": state, "resumable": resumable, "link": links}
    may = allowed("online", document, **({"link": True} | more))
    return {command for command, why_not in may.items() if not why_not}


@pytest.mark.parametrize("state", [one.value for one in MissionState])
def test_each_state_has_its_commands(state: str) -> None:
    flying = {
        "preflight": {"pause", "skip", "repeat", "finish", "abort", "plan"},
        "capturing": {"pause", "skip", "repeat", "finish", "abort", "plan"},
        "paused": {"resume", "skip", "repeat", "finish", "abort", "plan"},
        "finishing": {"abort", "plan"},
    }
    assert possible(state) == flying.get(state, {"start", "plan"})


def test_an_interrupted_mission_can_be_resumed_or_given_up() -> None:
    assert possible("paused", resumable="20261122T075801.864Z") >= {"resume", "abort"}
    assert possible("idle", resumable="20261122T075801.864Z") == {"start", "plan", "resume", "abort"}


def test_what_is_missing_is_named() -> None:
    lost = LINKS | {"gimbal": {"ok": False, "age_s": None}, "camera": {"ok": False, "age_s": 9.0}}
    may = allowed("online", {"state": "idle", "resumable": None, "link": lost}, link=True)
    assert may["start"] == "gimbal and camera not ready"
    assert possible("capturing", links=lost) >= {"pause", "abort"}, "what stops is never greyed by a lost device"
    assert possible("idle", link=False) == set()
    assert set(allowed("offline", {"state": "idle"}, link=True).values()) == {"the vehicle is offline"}
    assert set(allowed("", None, link=True).values()) == {"nothing was heard from the vehicle yet"}


@pytest.mark.parametrize("text", ["d2 x1", "d-1", "d9999999", "dd", "\u0664", 7, None, "t" * 3 + "1", "d99999 d99999"])
def test_marks_that_make_no_sense_are_none(text: object) -> None:
    assert unfolded({"shots": text}) == ""
    assert unfolded(None) == ""


def test_marks_are_unfolded() -> None:
    assert unfolded({"shots": "d2 r1 c1 t3"}) == "ddrcttt"
