"""Where the time went: phases of each attempt, the limit, pauses, and the time when no process flew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.settings import MissionSettings
from panoexec.planning.model import Tolerance
from panoexec.report.source import Source
from panoexec.report.timeline import timeline
from tests.report_missions import START_UTC_S, stamp

SETTINGS = MissionSettings(
    tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7),
    settle_s=0.3,
    interval_s=2.0,
    exposure_s=0.02,
    latency_s=0.1,
)


def an_attempt(number: int, started_s: float, yaw_deg: float, *, settled_after_s: float | None = 1.0) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "number": number,
        "started": stamp(started_s),
        "verdict": "accepted",
        "target": {"pitch_deg": 0.0, "yaw_deg": yaw_deg},
    }
    return entry if settled_after_s is None else entry | {"slew_settle_s": settled_after_s, "trigger_delay_s": 0.01}


def a_source(shots: list[list[dict[str, Any]]], events: tuple[ev.Event, ...] = (), **more: Any) -> Source:
    manifest = {"shots": [{"index": i, "attempts": attempts} for i, attempts in enumerate(shots)]}
    return Source(folder=Path(), manifest=manifest, settings=SETTINGS, events=events, **more)


def exposed(shot: int, attempt: int, at_s: float) -> ev.Event:
    return ev.ShotExposed(
        shot=shot, attempt=attempt, time_utc_s=START_UTC_S + at_s, photos=(), pointing_ok=True, reason="", samples=5,
        measured=None, errors=None, slew_settle_s=1.0, trigger_delay_s=0.0,
    )  # fmt: skip


def test_where_the_interval_rules_the_rest_is_waiting_for_the_camera() -> None:
    # 45° of yaw take 0.75 s at 90°/s and 360°/s²; the camera is ready 2 s after its last trigger at 1.01 s
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 1.2, 45.0, settled_after_s=1.81)]]
    found = timeline(a_source(shots, (exposed(0, 1, 1.15), exposed(1, 1, 3.2))))
    second = found.attempts[1]
    assert second.slew_s == pytest.approx(0.75)
    assert second.settle_s == pytest.approx(0.3)
    assert second.wait_s == pytest.approx(1.81 - 0.75 - 0.3)
    assert second.expose_s == pytest.approx(0.19)
    assert second.limit_s == pytest.approx(2.0)
    assert found.duration_s == pytest.approx(3.2)
    # the first slew is taken as it was
    assert found.attempts[0].limit_s == pytest.approx(1.02)
    assert found.limit_s == pytest.approx(3.02)


def test_where_settling_rules_the_rest_is_settling() -> None:
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 1.2, 45.0, settled_after_s=3.0)]]
    second = timeline(a_source(shots, (exposed(0, 1, 1.15), exposed(1, 1, 4.4)))).attempts[1]
    assert [second.slew_s, second.settle_s, second.wait_s] == pytest.approx([0.75, 2.25, 0.0])


def test_a_retake_is_not_in_the_limit_and_an_attempt_without_a_photo_is_pointing() -> None:
    rejected = ev.ShotRejected(shot=1, attempt=1, code="not_settled", reason="", time_utc_s=START_UTC_S + 6.0)
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 1.2, 45.0, settled_after_s=None), an_attempt(2, 6.1, 45.0)]]
    found = timeline(a_source(shots, (exposed(0, 1, 1.15), rejected, exposed(1, 2, 7.2))))
    _, without, retake = found.attempts
    assert without.slew_s + without.settle_s == pytest.approx(4.8)
    assert without.expose_s == 0
    assert without.after_s == pytest.approx(0.1)
    assert retake.limit_s == 0
    assert retake.slew_s == 0
    assert found.limit_s == pytest.approx(1.02 + 2.0)


def test_pauses_are_told_apart_and_the_time_without_a_process_is_left_out() -> None:
    events = (
        ev.MissionStarted(shots_total=3, time_utc_s=START_UTC_S),
        exposed(0, 1, 1.15),
        ev.MissionPaused(code="mode", reason="", time_utc_s=START_UTC_S + 2.0),
        ev.MissionResumed(paused_s=5.0, time_utc_s=START_UTC_S + 7.0),
        exposed(1, 1, 9.0),
        ev.MissionStarted(shots_total=3, resumed=True, time_utc_s=START_UTC_S + 1009.0),
        exposed(2, 1, 1012.0),
    )
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 7.5, 45.0)], [an_attempt(1, 1010.5, 90.0)]]
    first, second, third = timeline(a_source(shots, events)).attempts
    assert first.paused_s == pytest.approx(5.0)
    assert first.after_s == pytest.approx(7.5 - 1.15)
    assert second.start_s == pytest.approx(7.5)
    assert third.start_s == pytest.approx(10.5)


def test_the_seconds_are_those_of_the_missions_clock_whatever_wall_time_did() -> None:
    # a vehicle simulated faster now and slower then; and wall time was set back by an hour on the way
    def at(event: ev.Event, clock_s: float, wall_s: float) -> ev.Event:
        return replace(event, clock_s=500.0 + clock_s, time_utc_s=START_UTC_S + wall_s)

    def started(shot: int) -> ev.Event:
        return ev.ShotStarted(shot=shot, attempt=1, round=0, pitch_deg=0.0, yaw_deg=45.0 * shot, patience_s=1.0)

    events = (
        at(ev.MissionStarted(shots_total=2), -0.5, -0.01),
        at(started(0), 0.0, 0.0),
        at(exposed(0, 1, 0.0), 1.15, 0.1),
        at(started(1), 1.2, 0.9 - 3600.0),
        at(exposed(1, 1, 0.0), 3.2, 1.0 - 3600.0),
    )
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 0.9 - 3600.0, 45.0, settled_after_s=1.81)]]
    found = timeline(a_source(shots, events, simulated=True))
    assert [item.start_s for item in found.attempts] == pytest.approx([0.0, 1.2])
    assert [item.expose_s for item in found.attempts] == pytest.approx([0.15, 0.19])
    assert found.duration_s == pytest.approx(3.2)
    assert found.lived_s == pytest.approx(3.7)


def test_a_sped_up_mission_tells_its_pace() -> None:
    events = (
        ev.MissionStarted(shots_total=1, time_utc_s=START_UTC_S, clock_s=7.0),
        replace(exposed(0, 1, 2.0), clock_s=27.0),
    )
    assert timeline(a_source([[]], events, simulated=True)).pace == pytest.approx(10.0)
    assert timeline(a_source([[]], events)).pace == 1.0


def test_without_a_journal_there_are_no_ends_and_no_limit() -> None:
    shots = [[an_attempt(1, 0.0, 0.0)], [an_attempt(1, 1.2, 45.0)]]
    manifest = a_source(shots).manifest
    found = timeline(Source(folder=Path(), manifest=manifest))
    assert found.limit_s != found.limit_s
    assert [item.start_s for item in found.attempts] == pytest.approx([0.0, 1.2])


def test_nothing_tried() -> None:
    assert timeline(a_source([[], []])).attempts == ()
