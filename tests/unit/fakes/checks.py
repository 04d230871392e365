"""What must hold of every mission, however it went: checked against the fakes' own truth."""

from __future__ import annotations

import numpy as np

from panoexec.angles import rotation, rotation_from_quaternion
from panoexec.mission.log import events as ev
from panoexec.mission.log.mark_text import ShotMark, marks_from_text
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_marks import marks_text
from panoexec.mission.log.shot_record import ShotStatus, Verdict
from panoexec.mission.log.states import ENDED, TRANSITIONS, MissionState
from panoexec.mission.pointing.poses import read_pose
from panoexec.planning.geometry.pose_error import pose_error
from tests.unit.fakes.world import World


def check_mission(world: World, record: MissionRecord) -> None:
    """All invariants of an ended or stopped mission."""
    check_announcements(world, record)
    check_states(world)
    check_commands(world)
    check_shots(world, record)
    check_accepted(world, record)
    check_end(world, record)


def check_announcements(world: World, record: MissionRecord) -> None:
    """Everything announced was durable, in order, once; the journal alone gives the same record."""
    journal = world.journal.events
    assert [event.seq for event in journal] == list(range(1, len(journal) + 1))
    announced = world.sink.events
    assert announced == journal[: len(announced)]
    again = MissionRecord.from_events(mission_id=record.mission_id, shots=world.plan.shots, events=journal)
    if len(journal) == record.seq:
        assert again.shots == record.shots
        assert again.state is record.state


def check_states(world: World) -> None:
    """No illegal transition."""
    state = MissionState.IDLE
    for event in world.journal.events:
        if isinstance(event, ev.MissionStarted):
            state = MissionState.IDLE
        assert event.state is state or event.state in TRANSITIONS[state], f"{state} to {event.state}"
        state = event.state


def check_commands(world: World) -> None:
    """What was answered is obeyed, through however many processes: no slew after an end, none to what was skipped."""
    over, skipped = "", set()
    for event in world.journal.events:
        match event:
            case ev.CommandReceived(command="abort" | "finish"):
                over = event.command
            case ev.CommandReceived(command="skip", shot=int(shot)):
                skipped.add(shot)
            case ev.CommandReceived(command="repeat", shot=int(shot)):
                skipped.discard(shot)
            case ev.ShotStarted():
                assert not over, f"shot {event.shot} after {over}"
                assert event.shot not in skipped
            case ev.MissionFinished() if over == "abort":
                assert event.state is MissionState.ABORTED


def check_shots(world: World, record: MissionRecord) -> None:
    """No shot lost or counted twice, and no photo counted for two shots."""
    assert {shot.index for shot in world.plan.shots} <= set(record.shots)
    assert record.shots_done + len(record.missing()) == record.shots_total
    assert record.attempts == sum(len(shot.attempts) for shot in record.shots.values())
    counted = [
        photo.image_index
        for shot in record.shots.values()
        for attempt in shot.attempts
        if attempt.verdict is Verdict.ACCEPTED
        for photo in attempt.photos
        if photo.image_index >= 0
    ]
    assert len(counted) == len(set(counted))
    if record.state is MissionState.COMPLETE and not record.certified:
        assert not record.missing()
    if record.state in {MissionState.COMPLETE, MissionState.INCOMPLETE}:
        left = {ShotStatus.PENDING, ShotStatus.ACTIVE, ShotStatus.EXPOSED, ShotStatus.DEFERRED}
        unfinished = [index for index, shot in record.shots.items() if shot.status in left]
        finished_early = any(
            isinstance(event, ev.CommandReceived) and event.command == "finish" for event in world.journal.events
        )
        assert not unfinished or finished_early


def check_accepted(world: World, record: MissionRecord) -> None:
    """Every accepted photo really exists, and the camera really looked there while its shutter was open."""
    tolerance = world.settings.tolerance
    for shot in record.shots.values():
        for attempt in shot.attempts:
            if attempt.verdict is not Verdict.ACCEPTED or attempt.by == "open_loop":
                continue
            exposed = attempt.exposed
            assert exposed is not None
            assert exposed.pointing_ok or (attempt.by == "overlap" and world.settings.accept == "overlap")
            assert exposed.measured is not None
            if attempt.by == "tolerance":  # record and verdict agree
                assert exposed.errors is not None
                assert abs(exposed.errors.pitch_deg) <= tolerance.pitch_deg
                assert abs(exposed.errors.roll_deg) <= tolerance.roll_deg
                assert abs(exposed.errors.yaw_deg) <= tolerance.yaw_deg
            for photo in attempt.photos:
                if photo.image_index < 0 or attempt.by == "overlap" or exposed.proof == "curve":
                    continue
                taken = world.camera.photos[photo.image_index]
                feed, north = world.gimbal.feed, record.reference_yaw_north_deg
                samples = [s for s in feed.since(taken.exposed_s - 0.1) if s.received_s <= taken.ended_s]
                during = [read_pose(sample, feed.vehicle_attitude_at(sample), north) for sample in samples]
                assert during, "accepted without samples"
                for reading in during[-3:]:
                    assert reading.rotation is not None
                    error = pose_error(attempt.pitch_deg, attempt.yaw_deg, reading.rotation)
                    assert bool(error.within(tolerance))
            target = rotation(attempt.yaw_deg, attempt.pitch_deg)
            cos = (np.trace(target.T @ rotation_from_quaternion(exposed.measured.q_wxyz)) - 1) / 2
            apart = np.degrees(np.arccos(np.clip(cos, -1, 1)))
            if attempt.by == "tolerance":
                assert apart <= tolerance.pitch_deg + tolerance.roll_deg + tolerance.yaw_deg


def check_counts(record: MissionRecord) -> None:
    """The counts of a mission agree with its attempts, and with the marks that a ground station counts."""
    marks = marks_from_text(marks_text(record), count=record.shots_total)
    assert len(marks) == record.shots_total
    assert sum(mark in {ShotMark.DONE, ShotMark.RETAKEN} for mark in marks) == record.shots_done
    assert record.shots_done + len(record.missing()) == record.shots_total
    if record.ended:
        assert marks.count(ShotMark.MISSING) == len(record.missing())
    if not record.retakes:
        assert ShotMark.RETAKEN not in marks
    tries = [a for shot in record.shots.values() for a in shot.attempts if a.verdict is not Verdict.INTERRUPTED]
    assert record.retakes == len(tries) - sum(shot.tries > 0 for shot in record.shots.values())
    assert record.attempts == sum(len(shot.attempts) for shot in record.shots.values())


def check_end(world: World, record: MissionRecord) -> None:
    """The gimbal is not ours any more, and the last event says how it ended; the counts agree."""
    check_counts(record)
    assert record.state in ENDED | {MissionState.PAUSED}
    if not world.gimbal.release_hangs:
        assert not world.gimbal.in_control
    last = world.journal.events[-1]
    assert isinstance(last, ev.MissionFinished | ev.MissionPaused)
    if world.gimbal.acquired:
        assert any(isinstance(event, ev.GimbalReleased) for event in world.journal.events)
