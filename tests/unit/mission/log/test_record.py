"""The fold over a mission's events refuses what contradicts what came before: a damaged journal, or a fault of ours."""

from __future__ import annotations

from dataclasses import replace

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.errors import MissionError
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.log.states import IllegalTransitionError, MissionState
from panoexec.planning.model import Shot

S = MissionState
PHOTO = ev.Photo(number=1, evidence=EvidenceLevel.COUNTED, capture_time_utc_s=0.0)
STARTED = ev.ShotStarted(shot=0, attempt=1, round=0, pitch_deg=0.0, yaw_deg=0.0, patience_s=1.0)
EXPOSED = ev.ShotExposed(
    shot=0,
    attempt=1,
    photos=(PHOTO,),
    pointing_ok=True,
    reason="",
    samples=3,
    measured=None,
    errors=None,
    slew_settle_s=1.0,
    trigger_delay_s=0.0,
)
ACCEPTED = ev.ShotAccepted(shot=0, attempt=1, photos=(PHOTO,))
REJECTED = ev.ShotRejected(shot=0, attempt=1, code="pointing", reason="off")


def folded(*events: ev.Event) -> MissionRecord:
    """The record of a mission of two shots that was started, is capturing, and then saw these."""
    shots = [Shot(index=i, row=0, pitch_deg=0.0, yaw_deg=0.0) for i in range(2)]
    record = MissionRecord(mission_id="m", shots=shots)
    begun = [
        (ev.MissionStarted(shots_total=2), S.PREFLIGHT),
        (ev.PreflightPassed(), S.CAPTURING),
        *((event, S.CAPTURING if event.state is S.IDLE else event.state) for event in events),
    ]
    for seq, (event, state) in enumerate(begun, start=1):
        record.apply(replace(event, seq=seq, state=state))
    return record


def test_what_fits_together() -> None:
    record = folded(STARTED, EXPOSED, ACCEPTED)
    assert record.shots_done == 1
    assert record.shots[0].attempts[0].verdict is Verdict.ACCEPTED


@pytest.mark.parametrize(
    ("events", "why"),
    [
        ([ACCEPTED], "which is not open"),
        ([STARTED, ACCEPTED], "without an exposure"),
        ([STARTED, STARTED], "cannot begin now"),
        ([replace(STARTED, attempt=2)], "cannot begin now"),
        ([STARTED, EXPOSED, ACCEPTED, ACCEPTED], "which is not open"),
        ([STARTED, EXPOSED, ACCEPTED, REJECTED], "which is not open"),
        ([STARTED, REJECTED, EXPOSED], "which is not open"),
    ],
)
def test_a_verdict_belongs_to_one_open_attempt(events: list[ev.Event], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        folded(*events)


@pytest.mark.parametrize("state", [S.PREFLIGHT, S.COMPLETE, S.INCOMPLETE])
def test_an_illegal_transition_is_refused(state: MissionState) -> None:
    with pytest.raises(IllegalTransitionError, match=f"from capturing to {state}"):
        folded(ev.Warned(code="x", text="y", state=state))
    assert issubclass(IllegalTransitionError, MissionError)


def test_an_event_that_is_missing_or_comes_twice_is_refused() -> None:
    record = folded(STARTED)
    for seq in (record.seq, record.seq + 2):
        with pytest.raises(ValueError, match="an event is missing or duplicated"):
            record.apply(replace(EXPOSED, seq=seq, state=S.CAPTURING))
    assert record.shots[0].attempts[0].exposed is None


def test_a_new_process_does_not_have_the_gimbal_that_the_last_one_left_behind() -> None:
    record = folded(ev.GimbalAcquired(), ev.MissionStarted(shots_total=2, resumed=True, state=S.PREFLIGHT))
    assert (record.gimbal_held, record.gimbal_left) == (False, True)
    record.apply(ev.GimbalReleased(seq=record.seq + 1, state=S.PREFLIGHT))
    assert (record.gimbal_held, record.gimbal_left) == (False, False)
