"""What the page shows of a mission: folded from real events, whatever their order, and from hostile ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.mission.log import events as ev
from panoexec.web import words
from panoexec.web.mission import Mission
from panoexec.web.values import quaternion

PLAN = json.loads((Path(__file__).parents[3] / "examples" / "plan.json").read_text(encoding="utf-8"))
ID = "20261122T075801.864Z"


def event(seq: int, cls: type[ev.Event], **fields: Any) -> dict[str, Any]:
    document = cls(mission_id=ID, seq=seq, time_utc_s=1e9, **fields).to_json()
    loaded: dict[str, Any] = json.loads(json.dumps(document))
    return loaded


def started(seq: int, shot: int, attempt: int = 1) -> dict[str, Any]:
    where = {"round": 0, "pitch_deg": -10.0, "yaw_deg": 20.0, "patience_s": 10.0}
    return event(seq, ev.ShotStarted, shot=shot, attempt=attempt, **where)


def accepted(seq: int, shot: int, attempt: int = 1) -> dict[str, Any]:
    return event(seq, ev.ShotAccepted, shot=shot, attempt=attempt, photos=())


def test_plan_and_events_become_shots_with_attempts() -> None:
    mission = Mission(ID)
    mission.take_plan(PLAN, guess=False)
    mission.take_event(started(1, 3))
    mission.take_event(
        event(2, ev.ShotRejected, shot=3, attempt=1, code="pointing", reason="moved 0.4° during the exposure")
    )
    mission.take_event(started(3, 3, attempt=2))
    _, line, changed = mission.take_event(accepted(4, 3, attempt=2))
    assert changed == 3
    assert line is not None
    assert (line["level"], line["text"]) == ("good", "Shot 3 taken at attempt 2")
    document = mission.document()
    assert len(document["shots"]) == len(PLAN["shots"])
    shot = document["shots"][3]
    assert shot["accepted"] == 2
    assert [one["verdict"] for one in shot["attempts"]] == ["rejected", "accepted"]
    assert abs(document["camera"]["half_width"] - 17.3 / (2 * 14.87)) < 1e-6
    assert not document["gap"]
    assert "Shot 3 rejected: moved 0.4° during the exposure" in [one["text"] for one in document["events"]]


def test_an_accepted_shot_that_is_taken_back_counts_no_more() -> None:
    mission = Mission(ID)
    for one in (
        started(1, 0),
        accepted(2, 0),
        started(3, 0, attempt=2),
        accepted(4, 0, attempt=2),
        event(5, ev.ShotRevoked, shot=0, attempt=2, code="echo", reason="r"),
    ):
        mission.take_event(one)
    assert mission.shots[0]["accepted"] == 1


def test_the_same_event_twice_counts_once_and_a_late_one_closes_the_gap() -> None:
    mission = Mission(ID)
    assert mission.take_event(started(1, 0))[0]
    assert mission.take_event(accepted(3, 1))[0]
    assert mission.gap
    assert not mission.take_event(accepted(3, 1))[0]
    assert mission.take_event(accepted(2, 0))[0]
    assert not mission.gap


def test_patches_are_shots_too() -> None:
    mission = Mission(ID)
    patch = {"shots": (9,), "rows": (-1,), "pitch_deg": (5.0,), "yaw_deg": (6.0,), "holes": 1, "largest_hole_deg": 0.5}
    mission.take_event(event(1, ev.PatchPlanned, **patch))
    assert mission.shots[9]["patch"]
    assert mission.shots[9]["target"] == [5.0, 6.0]


def test_words_are_for_types_that_there_are_and_any_other_type_gets_its_name() -> None:
    assert set(words._SPECIAL) | words._QUIET <= set(ev.EVENT_TYPES)
    assert words.line({"type": "bridge_of_tomorrow", "reason": "r"}) == ("info", "Bridge of tomorrow: r")


@given(st.floats(-90, 90), st.floats(-180, 180))
def test_quaternions_are_those_of_the_angles(pitch: float, yaw: float) -> None:
    w, x, y, z = quaternion(pitch, yaw)
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert np.allclose(matrix, rotation(yaw, pitch), atol=1e-5)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
names = st.sampled_from(
    ["type", "seq", "shot", "attempt", "photos", "errors", "measured", "ties", "edges", "shots", "pitch_deg", "reason"]
)


def sent(mission: Mission) -> dict[str, Any]:
    """The document as a browser gets it, whose JSON has no NaN."""
    out: dict[str, Any] = json.loads(json.dumps(mission.document(), allow_nan=False))
    return out


@given(
    st.dictionaries(names, anything, max_size=12),
    st.sampled_from([*sorted(ev.EVENT_TYPES), "nonsense"]),
    st.integers(1, 5),
)
def test_no_event_can_break_it(fields: dict[str, Any], kind: str, seq: int) -> None:
    mission = Mission(ID)
    mission.take_event({"seq": seq, "type": kind, "shot": 1, "attempt": 1} | fields)
    mission.take_event(fields)
    assert sent(mission)["id"] == ID


def test_a_camera_without_a_field_of_view_is_none() -> None:
    """1e308 mm is a number in JSON, and half of its angle would be Infinity, which no browser reads."""
    camera = {"sensor_width_mm": 1e308, "sensor_height_mm": 13.0, "focal_length_mm": 1e-4}
    mission = Mission(ID)
    mission.take_plan({"camera": camera}, guess=False)
    assert sent(mission)["camera"] is None


@given(st.dictionaries(st.sampled_from(["camera", "constraints", "shots", "certificate", "notes"]), anything))
def test_no_plan_can_break_it(plan: dict[str, Any]) -> None:
    mission = Mission(ID)
    mission.take_plan(plan, guess=False)
    assert sent(mission)["id"] == ID
