"""What is shown of vehicles, from messages as they come: in order, twice, incomplete."""

from __future__ import annotations

from typing import Any

import pytest
from rich.console import Console, RenderableType

from panoexec.cli.sphere_map import LEGEND, Mark
from panoexec.cli.watch_view import Watched, fleet_view, mission_view
from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.plan_file import camera_to_data

LINKS = {name: {"ok": name != "camera", "age_s": 0.1} for name in ("autopilot", "gimbal", "camera")}
STATE: dict[str, Any] = {
    "state": "capturing",
    "shots_total": 18,
    "shots_done": 9,
    "retakes": 2,
    "eta_s": 72.4,
    "reason": "wind",
    "link": LINKS,
    "battery_frac": 0.744,
}


def shown(view: RenderableType, width: int = 120) -> str:
    console = Console(width=width, record=True, file=open("/dev/null", "w", encoding="utf-8"))  # noqa: SIM115, PTH123
    with console.file:
        console.print(view)
        return console.export_text()


def event(kind: str, number: int, **fields: Any) -> dict[str, Any]:
    return {"type": kind, "id": f"m/{number}", **fields}


def test_a_mission_is_shown_with_progress_and_the_last_attempts() -> None:
    one = Watched()
    one.hear("status", "online")
    one.hear("state", STATE)
    errors = {"pitch_deg": -2.0, "roll_deg": 0.01, "yaw_deg": None}
    for document in (
        event("mission_started", 1, shots_total=18),
        event("shot_started", 2, shot=3, attempt=1, pitch_deg=-29.5, yaw_deg=154.3),
        event("shot_exposed", 3, shot=3, attempt=1, errors=errors),
        event("shot_rejected", 4, shot=3, attempt=1, reason="pitch off by -2.00°"),
        event("shot_rejected", 4, shot=3, attempt=1, reason="the same once more"),
        event("shot_retaken", 5, shot=3, attempt=2, reason="again"),
        event("shot_accepted", 6, shot=3, attempt=2),
        event("mission_paused", 7, reason="the sun is gone"),
    ):
        one.hear("event", document)
    text = shown(mission_view("drone", one))
    for part in ("drone", "online", "capturing", "wind", "9/18", "2 retakes", "1:12 left", "battery 74 %"):
        assert part in text
    assert "camera lost" in text
    rows = [line for line in text.splitlines() if line.split()[:1] == ["3"]]
    assert len(rows) == 2
    assert "-29.5° +154.3°" in rows[0]
    assert "rejected" in rows[0]
    assert "-2.00° +0.01° ?" in rows[0]
    assert "pitch off by -2.00°" in rows[0]
    assert "accepted" in rows[1]
    assert "mission paused: the sun is gone" in text
    assert len(one.events) == 7, "an event that comes twice counts once"


def test_the_sphere_is_drawn_where_there_is_room() -> None:
    one = Watched()
    camera = camera_to_data(load_profile("dji-x5s-15mm").camera)
    shots = [{"index": n, "row": 0, "pitch_deg": -20, "yaw_deg": 60 * n - 150} for n in range(6)]
    one.hear("plan", {"shots": shots, "camera": camera})
    for number, (kind, shot, attempt) in enumerate(
        (
            *(("shot_accepted", 0, 1), ("shot_rejected", 1, 1), ("shot_accepted", 1, 2), ("shot_missed", 2, 1)),
            *(("shot_rejected", 3, 1), ("shot_started", 4, 1)),
        )
    ):
        one.hear("event", event(kind, number, shot=shot, attempt=attempt))
    assert one.marks() == {0: Mark.DONE, 1: Mark.RETAKEN, 2: Mark.MISSING, 3: Mark.AGAIN, 4: Mark.CURRENT}
    text = shown(mission_view("drone", one, room=(100, 50)))
    for mark in (Mark.DONE, Mark.RETAKEN, Mark.MISSING, Mark.AGAIN, Mark.CURRENT, Mark.PENDING):
        assert LEGEND[mark][1] in text
    for room in ((39, 50), (100, 19)):
        assert LEGEND[Mark.DONE][1] * 3 not in shown(mission_view("drone", one, room=room))
    one.hear("event", event("shot_started", 90, shot=0, attempt=2))
    assert one.marks()[0] is Mark.CURRENT
    one.hear("event", event("shot_rejected", 91, shot=0, attempt=2))
    assert one.marks()[0] is Mark.DONE, "the earlier photo counts until a new one does"
    one.hear("plan", None)
    assert LEGEND[Mark.DONE][1] * 3 not in shown(mission_view("drone", one, room=(100, 50)))


def test_who_comes_late_sees_all_that_was_done_before() -> None:
    one = Watched()
    one.hear("state", STATE | {"shots_total": 6, "shots": "d1 r1 m1 a1 c1 t1"})
    one.hear("event", event("shot_started", 90, shot=4, attempt=1))
    assert list(one.marks().values()) == [
        *(Mark.DONE, Mark.RETAKEN, Mark.MISSING, Mark.AGAIN, Mark.CURRENT, Mark.PENDING)
    ]
    for nonsense in ("d7", "d5 ?", None, 3):
        one.hear("state", STATE | {"shots_total": 6, "shots": nonsense})
        assert one.marks() == {4: Mark.CURRENT}


def test_a_photo_that_arrives_late_makes_no_empty_line() -> None:
    one = Watched()
    one.hear("state", STATE | {"retakes": 1})
    one.hear("event", event("photo_stored", 1, shot=0, attempt=1))
    assert not one.attempts
    one.hear("event", event("shot_started", 2, shot=1, attempt=1))
    one.hear("event", event("photo_stored", 3, shot=1, attempt=1))
    assert [(each.shot, each.verdict) for each in one.attempts.values()] == [(1, "slewing")]
    assert "1 retake " in shown(mission_view("drone", one))


def test_only_the_last_attempts_are_shown_and_a_new_mission_begins_anew() -> None:
    one = Watched()
    for number in range(40):
        one.hear("event", event("shot_accepted", number, shot=number, attempt=1))
    text = shown(mission_view("drone", one))
    assert " 39 " in text
    assert " 27 " not in text
    one.hear("event", event("mission_started", 99, shots_total=1))
    assert " 39 " not in shown(mission_view("drone", one))


@pytest.mark.parametrize("state", ["complete", "incomplete", "aborted", "failed"])
def test_a_mission_ends_once_it_was_seen_to_fly(state: str) -> None:
    one = Watched()
    one.hear("state", {"state": state})
    assert one.ended == "", "that one ended before"
    one.hear("state", {"state": "capturing"})
    one.hear("state", {"state": state})
    assert (one.ended, one.finished) == (state, False)
    one.hear("event", event("mission_finished", 9, reason="done"))
    assert one.finished


@pytest.mark.parametrize(
    "change",
    [
        {"camera": None},
        {"camera": {"hfov_deg": "wide", "vfov_deg": 40}},
        {"camera": {"hfov_deg": 60}},
        {"camera": {"hfov_deg": True, "vfov_deg": 40}},
        {"camera": {"hfov_deg": float("nan"), "vfov_deg": 40}},
        {"camera": {"hfov_deg": 400, "vfov_deg": 40}},
        {"shots": None},
        {"shots": []},
        {"shots": [5]},
        {"shots": [{"index": 0, "pitch_deg": 91, "yaw_deg": 0}]},
        {"shots": [{"index": 0, "pitch_deg": 0, "yaw_deg": float("inf")}]},
        {"shots": [{"index": "x", "pitch_deg": 0, "yaw_deg": 0}]},
        {"shots": [{"index": float("inf"), "pitch_deg": 0, "yaw_deg": 0}]},
        {"shots": [{"index": 0, "yaw_deg": 0}]},
    ],
)
def test_a_plan_that_is_none_is_not_drawn(change: dict[str, Any]) -> None:
    plan = {
        "camera": {"hfov_deg": 60, "vfov_deg": 40},
        "shots": [{"index": 0, "pitch_deg": 0, "yaw_deg": 0}],
    }
    one = Watched()
    one.hear("plan", plan)
    assert one.map((100, 50), beside=8) is not None
    one.hear("plan", plan | change)
    assert one.map((100, 50), beside=8) is None


@pytest.mark.parametrize("document", [None, 5, "x", [], {}, {"type": None, "id": 3, "shot": "x", "errors": 3}])
def test_what_a_stranger_publishes_there_does_no_harm(document: Any) -> None:
    one = Watched()
    for kind in ("state", "event", "plan", "status"):
        one.hear(kind, document)
    assert "drone" in shown(mission_view("drone", one))
    assert "drone" in shown(mission_view("drone", one, room=(80, 30)), 80)
    assert "drone" in shown(fleet_view({"drone": one}))
    assert not one.finished


def test_a_fleet_is_a_line_each() -> None:
    sound, silent = Watched(), Watched()
    sound.hear("status", "online")
    sound.hear("state", STATE)
    silent.hear("status", "offline")
    lines = shown(fleet_view({"b": silent, "a": sound})).splitlines()
    assert lines[0].split() == ["vehicle", "status", "state", "shots", "retakes", "left", "links", "battery", "reason"]
    assert lines[1].split() == ["a", "online", "capturing", "9/18", "2", "1:12", "no", "camera", "74", "%", "wind"]
    assert lines[2].split()[:2] == ["b", "offline"]


def long_mission() -> Watched:
    """Everything that can be long is long."""
    one = Watched()
    camera = camera_to_data(load_profile("dji-x5s-15mm").camera)
    shots = [{"index": n, "row": 0, "pitch_deg": -20, "yaw_deg": 60 * n - 150} for n in range(6)]
    one.hear("status", "online")
    one.hear("plan", {"shots": shots, "camera": camera})
    one.hear("state", STATE | {"reason": "the wind is too strong " * 9, "shots_total": 6, "shots": "d1 r1 m1 a1 c1 t1"})
    for number in range(30):
        fields = {"shot": number % 6, "attempt": number // 6 + 1}
        one.hear("event", event("shot_started", 3 * number, pitch_deg=-29.5, yaw_deg=154.3, **fields))
        errors = {"pitch_deg": -2.0, "roll_deg": 0.01, "yaw_deg": -0.5}
        one.hear("event", event("shot_exposed", 3 * number + 1, errors=errors, **fields))
        one.hear("event", event("shot_rejected", 3 * number + 2, reason="pitch off by -2.00°, and more " * 5, **fields))
    one.hear("event", event("mission_paused", 99, reason="the sun is gone " * 20))
    return one


@pytest.mark.parametrize("columns", [50, 64, 80, 89, 90, 132])
@pytest.mark.parametrize("lines", [12, 20, 24, 30, 50])
def test_what_is_shown_fits_a_terminal(columns: int, lines: int) -> None:
    one = long_mission()
    view = mission_view("drone", one, room=(columns, lines), note="pause drone? y yes, any other key no")
    told = shown(view, columns).rstrip("\n").splitlines()
    assert len(told) <= lines
    assert max(map(len, told)) <= columns
    assert told[-1].startswith("pause drone? y yes")
    text = "\n".join(told)
    for part in ("drone", "online", "capturing", "9/6", "2 retakes", "1:12 left", "rejected", "pitch off", "the sun"):
        assert part in text
    assert ("+30" in text) is (lines >= 24), "the map"


@pytest.mark.parametrize("reference", ["north", "heading", None])
def test_azimuths_have_names_only_where_yaw_0_is_north(reference: str | None) -> None:
    one = long_mission()
    one.hear("state", STATE | {"reference": reference})
    line = next(x for x in shown(mission_view("drone", one, room=(80, 24)), 80).splitlines() if "90" in x or " N " in x)
    assert line.split() == (["S", "W", "N", "E", "S"] if reference == "north" else ["-180", "-90", "0°", "+90", "+180"])


def test_a_fleet_fits_50_columns() -> None:
    one = long_mission()
    lines = shown(fleet_view({"kite": one, "drone": one}, columns=50), 50).splitlines()
    assert len(lines) == 3
    assert max(map(len, lines)) <= 50
    assert lines[1].split()[:5] == ["drone", "online", "capturing", "9/6", "1:12"]


def test_it_is_said_who_commanded() -> None:
    one = Watched()
    one.hear("event", event("command_received", 1, command="pause", by="anna@laptop", reason="rain"))
    assert "pause received from anna@laptop: rain" in shown(mission_view("drone", one))
    one.hear("event", event("command_received", 2, command="resume"))
    assert "resume received\n" in shown(mission_view("drone", one)).replace(" \n", "\n").replace("  ", "")
