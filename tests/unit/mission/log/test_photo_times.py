"""Whether the time in a photo's file fits its attempt: of any clock, in whole seconds, rounded, stepped, or swapped."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.devices import EvidenceLevel
from panoexec.mission.log import events as ev
from panoexec.mission.log.photo_times import PhotoTimes
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.states import MissionState
from panoexec.planning.model import Shot

UTC_S = 1_790_000_000.0
"""When the mission's clock was 0, by this computer's clock."""


class Mission:
    """A record whose attempts took one photo each, at given moments of the mission's clock."""

    def __init__(self, times_s: Sequence[float], *, told: bool = True, utc_step_at: int | None = None) -> None:
        shots = [Shot(index=index, row=0, pitch_deg=0.0, yaw_deg=float(index)) for index in range(len(times_s))]
        self.record = MissionRecord(mission_id="m", shots=shots)
        self._add(ev.MissionStarted(shots_total=len(shots)), 0.0)
        for state in (MissionState.PREFLIGHT, MissionState.CAPTURING):
            self.state = state
            self._add(ev.Warned(code="c", text="t"), 0.0)
        for index, at_s in enumerate(times_s):
            step_s = 0.0 if utc_step_at is None or index < utc_step_at else -40_000.0
            utc_s = UTC_S + step_s + at_s
            photo = ev.Photo(
                number=1,
                evidence=EvidenceLevel.CAPTURE_MESSAGE,
                capture_time_utc_s=utc_s if told else math.nan,
                file=f"IMG_{index}.jpg",
            )
            started = ev.ShotStarted(shot=index, attempt=1, round=0, pitch_deg=0, yaw_deg=0, patience_s=1)
            self._add(started, at_s - 1, utc_s - 1)
            exposed = ev.ShotExposed(
                shot=index,
                attempt=1,
                photos=(photo,),
                pointing_ok=True,
                reason="",
                samples=9,
                measured=None,
                errors=None,
                slew_settle_s=1,
                trigger_delay_s=0,
            )
            self._add(exposed, at_s + 0.7, utc_s + 0.7)
            self._add(ev.ShotAccepted(shot=index, attempt=1, photos=(photo,)), at_s + 0.8, utc_s + 0.8)

    state = MissionState.IDLE

    def _add(self, event: ev.Event, clock_s: float, utc_s: float = UTC_S) -> None:
        from dataclasses import replace  # noqa: PLC0415

        self.record.apply(replace(event, seq=self.record.seq + 1, clock_s=clock_s, time_utc_s=utc_s, state=self.state))

    def store(self, shot: int, taken_s: float, resolution_s: float = 1.0) -> str:
        """Store a photo's file; returns what contradicts it by then."""
        event = ev.PhotoStored(
            shot=shot,
            attempt=1,
            file=f"images/{shot}.jpg",
            size_bytes=1,
            sha256="0" * 64,
            source="http",
            taken_s=taken_s,
            taken_resolution_s=resolution_s if math.isfinite(taken_s) else math.nan,
        )
        why = self.record.times.judge(shot, self.record.shots[shot].attempts[0], event)
        self._add(event, 900.0)
        return why

    @property
    def odd(self) -> list[int]:
        """Shots whose photo contradicts its attempt."""
        return [shot for shot, _, _ in sorted(self.record.times.contradictions)]


def camera_clock(at_s: float, offset_s: float) -> float:
    """What a camera writes that cuts off the fraction."""
    return float(math.floor(UTC_S + at_s + offset_s))


@pytest.mark.parametrize("told", [True, False])
@given(
    st.floats(-1e6, 1e6),
    st.lists(st.floats(1.5, 30), min_size=1, max_size=40),
    st.sampled_from(["cut", "rounded", "fine"]),
    st.floats(-2e-4, 2e-4),
    st.integers(0, 1 << 30),
)
def test_photos_of_one_clock_never_contradict_however_wrong_it_is(
    told: bool, offset_s: float, gaps_s: list[float], form: str, drift: float, seed: int
) -> None:
    times_s = [sum(gaps_s[: index + 1]) for index in range(len(gaps_s))]
    mission, rng = Mission(times_s, told=told), random.Random(seed)
    order = list(range(len(times_s)))
    rng.shuffle(order)  # files arrive in any order
    for shot in order:
        true_s = UTC_S + offset_s + times_s[shot] * (1 + drift) + rng.uniform(0, 0.6)
        written = {"cut": math.floor(true_s), "rounded": round(true_s), "fine": round(true_s, 2)}[form]
        assert mission.store(shot, written, 0.01 if form == "fine" else 1.0) == ""
    assert mission.odd == []
    assert mission.record.warnings == ["t", "t"]


def test_two_photos_that_were_swapped_are_both_told() -> None:
    times_s = [6.0 * index for index in range(20)]
    mission = Mission(times_s)
    for shot, at_s in enumerate(times_s):
        taken_s = {7: times_s[8], 8: times_s[7]}.get(shot, at_s)
        why = mission.store(shot, camera_clock(taken_s, -7200))
        assert bool(why) == (shot in {7, 8})
    assert mission.odd == [7, 8]
    assert "before its trigger" in mission.record.times.contradictions[8, 1, 1]
    (warning,) = [text for text in mission.record.warnings if text != "t"]
    assert warning.startswith("2 photos contradict the time of their trigger: shot 7 (its file tells")


def test_the_first_photos_are_judged_as_soon_as_others_agree() -> None:
    times_s = [8.0 * index for index in range(6)]
    mission = Mission(times_s)
    assert mission.store(0, camera_clock(times_s[0] - 3600, 0)) == "", "nothing to compare it with"
    for shot in range(1, 4):
        mission.store(shot, camera_clock(times_s[shot], 0))
    assert mission.odd == [0]


def test_a_clock_that_was_set_in_the_middle_of_a_mission_contradicts_nobody() -> None:
    times_s = [5.0 * index for index in range(30)]
    mission = Mission(times_s)
    for shot, at_s in enumerate(times_s):
        mission.store(shot, camera_clock(at_s, 0 if shot < 15 else 3600))
    assert mission.odd == []


def test_this_computers_clock_may_be_set_too() -> None:
    times_s = [5.0 * index for index in range(20)]
    mission = Mission(times_s, utc_step_at=9)
    for shot, at_s in enumerate(times_s):
        mission.store(shot, camera_clock(at_s, 99))
    assert mission.odd == []


def test_few_photos_files_without_a_time_and_photos_of_nobody_say_nothing() -> None:
    mission = Mission([0.0, 10.0, 20.0, 30.0, 40.0])
    mission.store(0, math.nan)
    mission.store(1, camera_clock(10, 0))
    mission.store(2, camera_clock(20, 500))
    mission.store(3, camera_clock(30, 9000))
    assert mission.odd == []
    assert PhotoTimes().contradictions == {}


def test_a_photo_that_is_stored_again_is_judged_anew() -> None:
    times_s = [7.0 * index for index in range(8)]
    mission = Mission(times_s)
    for shot, at_s in enumerate(times_s):
        mission.store(shot, camera_clock(at_s + (60 if shot == 3 else 0), 0))
    assert mission.odd == [3]
    assert mission.store(3, camera_clock(times_s[3], 0)) == ""
    assert mission.odd == []
    assert mission.record.warnings == ["t", "t"]
