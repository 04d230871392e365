"""The state of a mission: a fold over its events, the same while it runs and after a restart."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from panoexec.angles import FloatArray, rotation, rotation_from_quaternion
from panoexec.devices import EvidenceLevel
from panoexec.mission.log import events as ev
from panoexec.mission.log.pending_commands import PendingCommands
from panoexec.mission.log.photo_times import PhotoTimes
from panoexec.mission.log.photo_warnings import PhotoWarnings
from panoexec.mission.log.shot_record import AttemptRecord, ShotRecord, ShotStatus, Verdict
from panoexec.mission.log.states import ENDED, MissionState, check_transition
from panoexec.mission.pointing.poses import pose_of
from panoexec.pictures.model import BAD
from panoexec.planning.model import Shot


class MissionRecord:
    """The state of a mission, built from its events.

    An event that contradicts earlier ones is a bug (or a damaged journal) and raises: an illegal transition, a verdict
    on an attempt that never began, a second verdict.
    """

    def __init__(self, *, mission_id: str, shots: Sequence[Shot]) -> None:
        self.mission_id = mission_id
        self.shots: dict[int, ShotRecord] = {shot.index: ShotRecord(shot=shot) for shot in shots}
        self.state = MissionState.IDLE
        self.reason = ""
        self.seq = 0
        self.reference = "north"
        self.reference_yaw_north_deg = math.nan
        self.origin: tuple[float, float, float] = (math.nan, math.nan, math.nan)
        """Latitude, longitude, altitude above sea level where the mission began, or continued after a restart."""
        self.origin_known = False
        """Whether the origin of this process is known."""
        self.first_origin = self.origin
        """The origin of the first process that knew one."""
        self.last_accepted: int | None = None
        """The most recently accepted shot."""
        self.started_utc_s = math.nan
        self.finished_utc_s = math.nan
        self.restarts = 0
        self.current: int | None = None
        self.gimbal_held = False
        """This process controls the gimbal."""
        self.gimbal_left = False
        """An earlier process ended without releasing the gimbal."""
        self.gimbal: ev.GimbalAcquired | None = None
        """The gimbal that was acquired last."""
        self.contradiction: ev.GimbalContradicted | None = None
        """The last contradiction between gimbal and autopilot."""
        self.open_loop = False
        self.certified: bool | None = None
        self.warnings: list[str] = []
        self._photo_warnings = PhotoWarnings(self.warnings)
        self.times = PhotoTimes()
        """What stored photos tell of the time at which they were taken."""
        self.reported_level = EvidenceLevel.COMMANDED
        """Evidence that the camera gives of its photos by reports of its own: `FEEDBACK_PIN`, `CAPTURE_MESSAGE`, or
        `COMMANDED` before its first report."""
        self.patch_rounds = 0
        self.bridge_rounds = 0
        self.content: ev.ContentJudged | None = None
        """What the content of all photos proves together; None while nothing was examined."""
        self.asked = PendingCommands()
        self._done: set[int] = set()
        self._attempts = 0

    @classmethod
    def from_events(cls, *, mission_id: str, shots: Sequence[Shot], events: Iterable[ev.Event]) -> MissionRecord:
        """Build the record from events."""
        record = cls(mission_id=mission_id, shots=shots)
        for event in events:
            record.apply(event)
        return record

    def apply(self, event: ev.Event) -> None:  # noqa: C901, PLR0912  (one case a kind of event)
        """Apply the next event.

        Raises:
            MissionError: an illegal state transition.
            ValueError: the event contradicts earlier ones.
        """
        if event.seq != self.seq + 1:
            raise ValueError(f"event {event.seq} follows {self.seq}: an event is missing or duplicated")
        if isinstance(event, ev.MissionStarted):
            self.state = MissionState.IDLE  # a new process: the state of the last one does not matter
        if event.state is not self.state:
            check_transition(self.state, event.state)
            self.state = event.state
            self.reason = ""
        self.seq = event.seq
        self.asked.apply(event)
        match event:
            case ev.MissionStarted():
                self._start(event)
            case ev.MissionAnchored():
                self._set_reference_frame(event)
            case ev.MissionPaused() | ev.MissionFinishing():
                self.reason = event.reason
            case ev.MissionFinished():
                self.reason = event.reason
                self.finished_utc_s = event.time_utc_s
                self.certified = event.certified
                self.current = None
            case ev.GimbalAcquired():
                self.gimbal_held = True
                self.gimbal = event
            case ev.GimbalContradicted():
                self.contradiction = event
                self.warnings.append(event.text)
            case ev.GimbalReleased():
                self.gimbal_held = self.gimbal_left = False
            case ev.Warned():
                self.warnings.append(event.text)
            case ev.PatchPlanned():
                self._patch(event)
            case ev.BridgePlanned():
                self._bridge(event)
            case ev.ContentJudged():
                self.content = event
            case ev.ShotEvent():
                self._apply_shot(event)
            case _:
                pass

    def _start(self, event: ev.MissionStarted) -> None:
        self.gimbal_left |= self.gimbal_held
        self.gimbal_held = False
        self.origin_known = False
        self._set_reference_frame(event)
        if event.resumed:
            self.restarts += 1
            return
        self.reference = event.reference
        self.started_utc_s = event.time_utc_s

    def _set_reference_frame(self, event: ev.MissionStarted | ev.MissionAnchored) -> None:
        if not self.origin_known and not math.isnan(event.latitude_deg):
            self.origin = (event.latitude_deg, event.longitude_deg, event.altitude_m)
            self.origin_known = True
            if math.isnan(self.first_origin[0]):
                self.first_origin = self.origin
        # earlier photos depend on this direction, so it is never changed
        if math.isnan(self.reference_yaw_north_deg):
            self.reference_yaw_north_deg = event.reference_yaw_north_deg

    def _patch(self, event: ev.PatchPlanned) -> None:
        self.patch_rounds += 1
        for index, row, pitch, yaw in zip(event.shots, event.rows, event.pitch_deg, event.yaw_deg, strict=True):
            shot = Shot(index=index, row=row, pitch_deg=pitch, yaw_deg=yaw)
            self.shots[index] = ShotRecord(shot=shot, patch=True)

    def _bridge(self, event: ev.BridgePlanned) -> None:
        self.bridge_rounds += 1
        pairs = zip(event.between[::2], event.between[1::2], strict=True)
        for index, pair, pitch, yaw in zip(event.shots, pairs, event.pitch_deg, event.yaw_deg, strict=True):
            shot = Shot(index=index, row=-1, pitch_deg=pitch, yaw_deg=yaw)
            self.shots[index] = ShotRecord(shot=shot, between=pair)

    def _note_reports(self, photos: Sequence[ev.Photo]) -> None:
        best = max((photo.evidence for photo in photos), default=EvidenceLevel.COMMANDED)
        if best >= EvidenceLevel.FEEDBACK_PIN:  # whether the file is seen does not depend on the camera
            self.reported_level = max(self.reported_level, min(best, EvidenceLevel.CAPTURE_MESSAGE))

    def _apply_shot(self, event: ev.ShotEvent) -> None:
        record = self.shots[event.shot]
        self._note_reports(getattr(event, "photos", ()))
        match event:
            case ev.ShotStarted():
                if record.open_attempt is not None or event.attempt != len(record.attempts) + 1:
                    raise ValueError(f"shot {event.shot}: attempt {event.attempt} cannot begin now")
                record.attempts.append(
                    AttemptRecord(
                        number=event.attempt,
                        round=event.round,
                        pitch_deg=event.pitch_deg,
                        yaw_deg=event.yaw_deg,
                        started_utc_s=event.time_utc_s,
                        seq=event.seq,
                        process=self.restarts,
                    )
                )
                record.status = ShotStatus.ACTIVE
                self.current = event.shot
                self._attempts += 1
            case ev.ShotExposed():
                attempt = self._open(event)
                attempt.exposed, attempt.photos = event, event.photos
                self.open_loop |= event.open_loop
                record.status = ShotStatus.EXPOSED
            case ev.ShotAccepted():
                attempt = self._open(event)
                if attempt.exposed is None:
                    raise ValueError(f"shot {event.shot}: attempt {event.attempt} accepted without an exposure")
                attempt.verdict, attempt.by, attempt.photos = Verdict.ACCEPTED, event.by, event.photos
                attempt.reason = attempt.exposed.reason if attempt.exposed.pointing_ok else ""
                record.status, record.reason = ShotStatus.ACCEPTED, ""
                self.last_accepted = event.shot
                self._done.add(event.shot)
            case ev.ShotRejected():
                attempt = self._open(event)
                attempt.verdict, attempt.code, attempt.reason = Verdict.REJECTED, event.code, event.reason
                attempt.photos = event.photos or attempt.photos
                record.status, record.reason = ShotStatus.PENDING, event.reason
            case ev.ShotRevoked():
                self._revoke(event, record)
            case ev.ShotInterrupted():
                attempt = self._open(event)
                attempt.verdict, attempt.reason = Verdict.INTERRUPTED, event.reason
                record.status = ShotStatus.PENDING
            case _:
                self._apply_decision(event, record)

    def _revoke(self, event: ev.ShotRevoked, record: ShotRecord) -> None:
        attempt = record.attempts[event.attempt - 1] if 1 <= event.attempt <= len(record.attempts) else None
        if attempt is None or attempt.verdict is not Verdict.ACCEPTED:
            raise ValueError(f"shot {event.shot}: attempt {event.attempt} is revoked, but was not accepted")
        attempt.verdict, attempt.by, attempt.code, attempt.reason = Verdict.REJECTED, "", event.code, event.reason
        attempt.photos = event.photos or attempt.photos
        self._tell_times()
        if record.accepted is not None:  # an earlier photo still counts
            return
        self._done.discard(event.shot)
        if self.last_accepted == event.shot:
            self.last_accepted = None
        if record.open_attempt is None:
            record.status, record.reason = ShotStatus.PENDING, event.reason

    def _apply_decision(self, event: ev.ShotEvent, record: ShotRecord) -> None:
        match event:
            case ev.ShotRetaken():
                pass  # the attempt that begins now counts
            case ev.ShotDeferred():
                record.status, record.reason = ShotStatus.DEFERRED, event.reason
            case ev.ShotMissed() | ev.ShotSkipped():
                ended = ShotStatus.MISSED if isinstance(event, ev.ShotMissed) else ShotStatus.SKIPPED
                # after a failed repeat the earlier photo still counts
                record.status = ended if record.accepted is None else ShotStatus.ACCEPTED
                record.reason = event.reason
            case ev.PhotoIdentified():
                attempt = record.attempts[event.attempt - 1]
                attempt.photos = event.photos
            case ev.PhotoStored():
                self._store(event, record)
            case ev.PhotoChecked():
                if not 1 <= event.attempt <= len(record.attempts):
                    raise ValueError(
                        f"shot {event.shot}: a photo of attempt {event.attempt} is checked, which never began"
                    )
                record.attempts[event.attempt - 1].checked = event
            case _:
                raise ValueError(f"no rule for {event.type}")

    def _store(self, event: ev.PhotoStored, record: ShotRecord) -> None:
        attempts = record.attempts
        if not 1 <= event.attempt <= len(attempts):
            raise ValueError(f"shot {event.shot}: a photo of attempt {event.attempt} is stored, which never began")
        attempts[event.attempt - 1].stored[event.photo] = event
        if event.differs:
            self._photo_warnings.settings(event.shot, ", ".join(event.differs))
        self.times.note(event.shot, attempts[event.attempt - 1], event)
        self._tell_times()

    def _tell_times(self) -> None:
        """Tell of accepted photos whose own time contradicts their attempt."""
        found = sorted(self.times.contradictions.items())
        self._photo_warnings.times({shot: why for (shot, number, _), why in found if self._is_accepted(shot, number)})

    def _is_accepted(self, shot: int, number: int) -> bool:
        return self.shots[shot].attempts[number - 1].verdict is Verdict.ACCEPTED

    def _open(self, event: ev.ShotEvent) -> AttemptRecord:
        attempts = self.shots[event.shot].attempts
        if not 1 <= event.attempt <= len(attempts) or attempts[event.attempt - 1].verdict is not Verdict.OPEN:
            raise ValueError(f"shot {event.shot}: {event.type} for attempt {event.attempt}, which is not open")
        return attempts[event.attempt - 1]

    def content_counts(self) -> dict[str, int]:
        """Accepted photos by the verdict on their content; empty while nothing was examined."""
        accepted = [shot.accepted for shot in self.shots.values()]
        verdicts = [
            attempt.checked.verdict for attempt in accepted if attempt is not None and attempt.checked is not None
        ]
        return dict(sorted(Counter(verdicts).items()))

    def bad_photos(self) -> dict[int, str]:
        """Shots whose accepted photo does not count for its content, with the verdict."""
        found = {}
        for index, shot in sorted(self.shots.items()):
            accepted = shot.accepted
            if accepted is not None and accepted.checked is not None and accepted.checked.verdict in BAD:
                found[index] = accepted.checked.verdict
        return found

    def bridge_ties(self) -> dict[int, tuple[int, ...]]:
        """Which of the two photos each bridge shot ties, by the last word on the content of all; empty before it."""
        if self.content is None:
            return {}
        edges = {frozenset(pair) for pair in zip(self.content.edges[::2], self.content.edges[1::2], strict=True)}
        return {
            index: tuple(end for end in shot.between if frozenset((index, end)) in edges)
            for index, shot in sorted(self.shots.items())
            if shot.between is not None
        }

    @property
    def ended(self) -> bool:
        """Whether the mission has ended."""
        return self.state in ENDED

    @property
    def shots_total(self) -> int:
        """Number of shots of the plan, patches and bridges."""
        return len(self.shots)

    @property
    def shots_done(self) -> int:
        """Number of shots with an accepted photo."""
        return len(self._done)

    @property
    def attempts(self) -> int:
        """Number of attempts begun, over all shots."""
        return self._attempts

    @property
    def retakes(self) -> int:
        """Number of tries beyond the first, over all shots (docs/contract.md)."""
        return sum(max(0, shot.tries - 1) for shot in self.shots.values())

    def missing(self) -> tuple[int, ...]:
        """Indices of shots without an accepted photo, in shooting order."""
        return tuple(index for index, r in sorted(self.shots.items()) if r.accepted is None)

    def measured(self, *, also: Sequence[tuple[int, ev.MeasuredPose]] = ()) -> tuple[FloatArray, list[int]]:
        """Measured attitudes of the accepted shots (n, 3, 3), camera to plan frame, and the row of each.

        Args:
            also: further shots with their poses; the last pose of a shot counts.
        """
        poses: dict[int, ev.MeasuredPose] = {}
        for index, shot in sorted(self.shots.items()):
            attempt = shot.accepted
            if attempt is not None and attempt.exposed is not None and attempt.exposed.measured is not None:
                poses[index] = attempt.exposed.measured
        poses |= dict(also)
        q = np.array([poses[index].q_wxyz for index in sorted(poses)], dtype=np.float64).reshape(-1, 4)
        rows = [self.shots[index].shot.row for index in sorted(poses)]
        return (rotation_from_quaternion(q) if rows else np.empty((0, 3, 3))), rows

    def wanted(self) -> list[tuple[int, ev.MeasuredPose]]:
        """The remaining shots with their expected poses: measured if exposed inside tolerance, else planned."""
        coming = {ShotStatus.PENDING, ShotStatus.ACTIVE, ShotStatus.DEFERRED, ShotStatus.EXPOSED}
        out = []
        for index, shot in sorted(self.shots.items()):
            if shot.status in coming and shot.accepted is None:
                attempt = shot.open_attempt
                exposed = None if attempt is None else attempt.exposed
                pose = None if exposed is None or not exposed.pointing_ok else exposed.measured
                out.append((index, pose or planned_pose(shot.shot)))
        return out

    def skipped(self) -> list[tuple[int, ev.MeasuredPose]]:
        """Skipped shots with their planned poses."""
        return [
            (index, planned_pose(shot.shot))
            for index, shot in sorted(self.shots.items())
            if shot.status is ShotStatus.SKIPPED
        ]

    def renumbered(self, shots: Sequence[Shot]) -> list[Shot]:
        """The shots with indices that continue those of the mission."""
        first = max(self.shots, default=-1) + 1
        return [replace(shot, index=first + i) for i, shot in enumerate(shots)]


def planned_pose(shot: Shot) -> ev.MeasuredPose:
    """The planned pose of a shot."""
    return pose_of(rotation(shot.yaw_deg, shot.pitch_deg))
