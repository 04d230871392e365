"""The content of photos decides, too: files that reach this computer are examined while the mission flies.

A photo of an accepted attempt that is unreadable, badly exposed, blurred, tied to nothing although it could be, or that
contradicts its neighbours is revoked with its reason and taken again, if the settings say so; otherwise it is told. The
examination runs in a process of its own (`PictureChecker`). A failure of it never fails a mission: the photos are
unchecked then, and said to be.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sized
from collections.abc import Set as AbstractSet
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import unquote, urlsplit

import structlog

from panoexec.angles import quaternion_from_rotation, rotation
from panoexec.clock import work
from panoexec.errors import PanoexecError
from panoexec.mission.bridging import Bridging
from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.log.shot_record import AttemptRecord, ShotRecord, Verdict
from panoexec.mission.parallax import moved_m, place_of
from panoexec.mission.protocols import PictureChecker
from panoexec.optics import Camera
from panoexec.pictures.model import BAD, Content, Judgement, Verdicts

MOST_RETAKES: Final = 10
"""So often a shot is taken again for its content; then the verdict stays, and the panorama is incomplete."""
_LOOK_S: Final = 0.25
_NO_FILE_S: Final = 10.0
"""Longest wait, real time, at the end of a mission for the first file to come."""
_NO_MORE_S: Final = 40.0
"""Longest wait without any progress where files do arrive; also for the examination to begin."""
_ENDING_S: Final = 2.0
"""The same where the mission is to end."""
_MANY: Final = 4

_log = structlog.get_logger(__name__)


class Revokes(Protocol):
    """Takes back an accepted photo and has it taken again (`Shooting.revoke`)."""

    def __call__(self, shot: int, number: int, code: str, reason: str, photos: tuple[ev.Photo, ...]) -> None:
        """Revoke attempt `number` of a shot."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureSource:
    """Where photos are, and what examines them.

    Attributes:
        folder: the mission directory.
        open: starts an examination for a camera.
        refused: files that were not stored, by shot and attempt, with the reason.
        coming: shots and attempts whose file is still being brought.
    """

    folder: Path
    open: Callable[[Camera], AbstractAsyncContextManager[PictureChecker]]
    refused: Callable[[], Mapping[tuple[int, int], str]] = dict
    coming: Callable[[], AbstractSet[tuple[int, int]]] = frozenset


class ContentCheck:
    """Examines the photos of one mission.

    Args:
        context: the mission.
        source: None: nothing is examined.
        revoke: takes a photo back.
    """

    def __init__(self, context: MissionContext, source: PictureSource | None, revoke: Revokes) -> None:
        self._context = context
        self._source = source if context.settings.pictures != "off" else None
        self._revoke = revoke
        self._bridging = Bridging(context)
        self._checker: PictureChecker | None = None
        self._ended = self._source is None
        self._failed = False
        self._unchecked: tuple[int, ...] = ()
        self._attempt_of: dict[int, int] = {}
        self._told: dict[tuple[int, int], tuple[str, tuple[float, float, float] | None]] = {}
        self._retakes: Counter[int] = Counter()
        self._planned = 0
        self._sizes: dict[Path, int] = {}
        self._progress_s = 0.0

    async def run(self) -> None:
        """Examine photos as they arrive, until cancelled."""
        if self._source is None:
            return
        try:
            async with self._source.open(self._context.plan.camera) as checker:
                self._checker = checker
                while True:
                    if not await self._examine_next(checker):
                        await asyncio.sleep(_LOOK_S)
        except PanoexecError as error:
            self._failed = True
            _log.warning("photos are not examined", error=str(error))
            text = f"the content of photos is not checked any more: {error}"
            self._context.recorder.emit(ev.Warned(code="pictures", text=text))
        finally:
            self._checker, self._ended = None, True

    async def settle(self) -> None:
        """Wait for files that are still to come, and judge all photos; afterwards, bad ones and bridges are queued."""
        requests, queue = self._context.requests, self._context.queue
        with work(self._context.clock):
            here = await self._wait_for_files()
            more = bool(len(queue)) and not requests.must_end_shooting  # one was taken back
            checker = self._checker
            if requests.stop is not None or more:
                return
            if self._ended:
                self._tell_unchecked()
            elif checker is not None and self._attempt_of:
                try:
                    await self._judge(checker)
                except PanoexecError as error:
                    _log.warning("photos are not judged", error=str(error))
                    self._give_up_check(str(error))
            elif here:
                self._give_up_check(f"of {here} files none could be examined in time")

    async def _wait_for_files(self) -> int:
        """Wait for files, and for their examination; returns how many are here that are not examined."""
        context, loop, here = self._context, asyncio.get_running_loop(), 0
        self._progress_s = loop.time()
        while context.requests.stop is None and not self._ended and not len(context.queue):
            waits = [shot for shot in context.record.shots.values() if self._is_awaited(shot)]
            here = sum(map(self._is_here, waits))
            patience_s = _NO_MORE_S if self._attempt_of or here else _NO_FILE_S
            if context.requests.must_end_shooting:
                patience_s = _ENDING_S
            if not waits or loop.time() - self._progress_s > patience_s:
                break
            await asyncio.sleep(_LOOK_S)
        return here

    def _give_up_check(self, why: str) -> None:
        """Say why photos whose files were here are unchecked; nothing more if a failure was told already."""
        if not self._failed:
            text = f"the content of photos is not checked: {why}"
            self._context.recorder.emit(ev.Warned(code="pictures", text=text))
        self._failed = True
        self._tell_unchecked()

    def _tell_unchecked(self) -> None:
        """After a failure no photo counts as examined: the mission must not end as if all were good."""
        shots = sorted(self._context.record.shots.items())
        unchecked = tuple(index for index, shot in shots if shot.accepted is not None)
        if self._failed and self._context.requests.stop is None and unchecked != self._unchecked:
            self._unchecked = unchecked
            self._context.recorder.emit(ev.ContentJudged(edges=(), groups=0, bridges=(), unchecked=unchecked))

    async def _judge(self, checker: PictureChecker) -> None:
        """Judge all photos; conclude if nothing was queued because of it."""
        queue = self._context.queue
        while True:
            await self._forget_revoked(checker)
            verdicts = await checker.judge(final=True)
            again = await self._apply(verdicts, checker, final=True)
            if not again and self._may_retake(verdicts.bad, len(verdicts.photos)):
                if await self._bridging.plan(checker):
                    return
                # what no bridge can help is taken again after all
                again = self._bridging.close() and await self._apply(verdicts, checker, final=True)
            if not again:
                break
            if len(queue):
                return
            # a photo was given up: what remains is judged without it
        self._conclude(verdicts)
        self._bridging.tell()

    # --- one photo after the other

    async def _examine_next(self, checker: PictureChecker) -> bool:
        """Examine the newest photo whose file is here; False if there is none."""
        await self._tell_plan(checker)
        await self._forget_revoked(checker)
        refused = self._source.refused() if self._source is not None else {}
        shots = sorted(self._context.record.shots.values(), key=_newest_first)
        for record in shots:
            attempt = record.accepted
            if attempt is None or self._attempt_of.get(record.shot.index) == attempt.number:
                continue
            shot = record.shot.index
            self._attempt_of.pop(shot, None)  # nobody drops the new photo for the old attempt
            q_wxyz, time_s = _pose(record, attempt)
            if (why := refused.get((shot, attempt.number))) is not None:
                code = Content.CONTRADICTS if "is the photo of shot" in why else Content.UNREADABLE
                verdicts = await checker.condemn(shot, code, why, q_wxyz, time_s)
            elif (path := self._file(attempt)) is not None:
                verdicts = await checker.add(shot, path, q_wxyz, time_s, self._heights_from_start(record, attempt))
            else:
                continue
            self._attempt_of[shot] = attempt.number
            self._progress_s = asyncio.get_running_loop().time()
            await self._apply(verdicts, checker, final=False)
            return True
        return False

    async def _forget_revoked(self, checker: PictureChecker) -> None:
        """Photos that were taken back for another reason (late evidence) are no evidence about their neighbours."""
        shots = self._context.record.shots
        stale = [
            shot
            for shot, number in self._attempt_of.items()
            if (accepted := shots[shot].accepted) is None or accepted.number != number
        ]
        for shot in stale:
            del self._attempt_of[shot]
        if stale:
            await checker.drop(stale)

    def _heights_from_start(self, record: ShotRecord, attempt: AttemptRecord) -> list[float] | None:
        """Where a photo was taken from the mission's origin, plan frame, heights above the ground; None if unknown."""
        place, mission = place_of(record, attempt.exposed), self._context.record
        if place is None or not all(map(math.isfinite, mission.first_origin)):
            return None
        moved = moved_m(mission.first_origin, place.position, mission.reference_yaw_north_deg)
        return [float(part) / place.height_m for part in moved]

    async def _tell_plan(self, checker: PictureChecker) -> None:
        record = self._context.record
        if len(record.shots) != self._planned:
            self._planned = len(record.shots)
            planned = {
                index: quaternion_from_rotation(rotation(one.shot.yaw_deg, one.shot.pitch_deg)).tolist()
                for index, one in record.shots.items()
            }
            await checker.plan(planned)

    def _file(self, attempt: AttemptRecord) -> Path | None:
        """The photo's file if it is here, whole."""
        assert self._source is not None
        stored = attempt.stored.get(1)
        if stored is not None:
            return self._source.folder / stored.file
        path = self._local(attempt)
        if path is None or not path.is_file():
            return None
        # nobody says that it is whole: not before its size stays the same
        size = path.stat().st_size
        before = self._sizes.get(path)
        self._sizes[path] = size
        return path if before == size else None

    def _local(self, attempt: AttemptRecord) -> Path | None:
        """The file that the camera told, if it is in the mission directory."""
        assert self._source is not None
        told = attempt.photos[0].file if attempt.photos else ""
        parts = urlsplit(told)
        if parts.scheme != "file" or parts.netloc not in {"", "localhost"}:
            return None
        path = Path(unquote(parts.path))
        return path if path.is_relative_to(self._source.folder.resolve()) else None

    def _is_awaited(self, record: ShotRecord) -> bool:
        """Whether the file of a shot's photo may still come."""
        attempt = record.accepted
        if attempt is None or self._attempt_of.get(record.shot.index) == attempt.number:
            return False
        assert self._source is not None
        coming = (record.shot.index, attempt.number) in self._source.coming()
        return coming or bool(attempt.stored) or self._local(attempt) is not None

    def _is_here(self, record: ShotRecord) -> bool:
        """Whether the file of a shot's photo has come, whole or not."""
        attempt = record.accepted
        path = None if attempt is None else self._local(attempt)
        return attempt is not None and (bool(attempt.stored) or (path is not None and path.is_file()))

    # --- verdicts

    async def _apply(self, verdicts: Verdicts, checker: PictureChecker, *, final: bool) -> bool:
        """Record what is new, and revoke bad photos; returns whether any was revoked."""
        record = self._context.record
        bad: list[tuple[int, int, Judgement]] = []
        for shot, judged in sorted(verdicts.photos.items()):
            number = self._attempt_of.get(shot)
            if number is None or not (judged.settled or final):
                continue
            attempt = record.shots[shot].attempts[number - 1]
            if attempt.verdict is not Verdict.ACCEPTED:
                continue
            # the last word has the estimate of the attitude from all ties
            new = (judged.verdict.value, judged.error_deg if final else None)
            if self._told.get((shot, number)) != new and (final or self._told.get((shot, number), ("",))[0] != new[0]):
                self._told[shot, number] = new
                self._context.recorder.emit(_checked(shot, number, judged))
            if judged.verdict in BAD:
                bad.append((shot, number, judged))
        if not self._may_retake(bad, len(verdicts.photos)):
            bad = [] if self._context.requests.must_end_shooting else self._contradicted_twice(bad)
        revoked = self._take_back(bad)
        if revoked:
            await checker.drop(revoked)
        return bool(revoked)

    def _contradicted_twice(self, bad: list[tuple[int, int, Judgement]]) -> list[tuple[int, int, Judgement]]:
        """Photos that are of other attempts by their content and by their own time: they never stay accepted."""
        times = self._context.record.times.contradictions
        return [
            (shot, number, replace(judged, reason=f"{judged.reason}; {times[shot, number, 1]}"))
            for shot, number, judged in bad
            if judged.verdict in {Content.CONTRADICTS, Content.UNTIED} and (shot, number, 1) in times
        ]

    def _take_back(self, bad: list[tuple[int, int, Judgement]]) -> list[int]:
        record = self._context.record
        revoked = []
        for shot, number, judged in bad:
            if record.shots[shot].between is not None and self._retakes[shot]:
                self._give_up(shot, number, judged)
            elif self._retakes[shot] < MOST_RETAKES and not self._waits_for_bridge(shot, judged):
                self._retakes[shot] += 1
                self._revoke(shot, number, judged.verdict.value, judged.reason, ())
            else:
                continue
            del self._attempt_of[shot]
            revoked.append(shot)
        return revoked

    def _waits_for_bridge(self, shot: int, judged: Judgement) -> bool:
        """Whether a second photo that nothing ties is kept until the end: a bridge is more likely to help."""
        before = any(attempt.code == Content.UNTIED.value for attempt in self._context.record.shots[shot].attempts)
        return judged.verdict is Content.UNTIED and before and self._bridging.may_help(shot)

    def _give_up(self, shot: int, number: int, judged: Judgement) -> None:
        """Nothing hangs on a bridge shot: a bad one is not taken again and again, and counts for nothing."""
        code, reason = judged.verdict.value, judged.reason
        self._context.recorder.emit(ev.ShotRevoked(shot=shot, attempt=number, code=code, reason=reason))
        self._context.recorder.emit(ev.ShotMissed(shot=shot, attempt=number, reason=f"a bridge that fails: {reason}"))

    def _may_retake(self, bad: Sized, checked: int) -> bool:
        """Whether bad photos are taken again: not when most are bad, because retakes would not be better."""
        if self._context.settings.pictures != "retake" or self._context.requests.must_end_shooting:
            return False
        return len(bad) < _MANY or 2 * len(bad) <= checked

    def _conclude(self, verdicts: Verdicts) -> None:
        graph, record = verdicts.graph, self._context.record
        unchecked = [
            index
            for index, shot in sorted(record.shots.items())
            if shot.accepted is not None
            and (index not in verdicts.photos or verdicts.photos[index].verdict is Content.UNCHECKED)
        ]
        loose = set(graph.geometry_only) | set(unchecked)
        self._context.recorder.emit(
            ev.ContentJudged(
                edges=tuple(shot for a, b, _ in graph.edges for shot in (a, b)),
                groups=sum(1 for group in graph.groups if not set(group) <= loose),
                bridges=tuple(shot for pair in graph.bridges for shot in pair),
                geometry_only=graph.geometry_only,
                geometry_bound_deg=verdicts.geometry_bound_deg if graph.geometry_only else math.nan,
                bad=tuple(sorted(found.shot for found in verdicts.bad)),
                unchecked=tuple(unchecked),
            )
        )


def _newest_first(record: ShotRecord) -> int:
    return -record.attempts[-1].seq if record.attempts else 0


def _pose(record: ShotRecord, attempt: AttemptRecord) -> tuple[list[float], float]:
    """Measured attitude (planned where nothing was measured), and when it was taken."""
    exposed = attempt.exposed
    if exposed is None or exposed.measured is None:
        pose = quaternion_from_rotation(rotation(record.shot.yaw_deg, record.shot.pitch_deg))
        return [float(part) for part in pose], math.nan if exposed is None else exposed.clock_s
    return list(exposed.measured.q_wxyz), exposed.clock_s


def _checked(shot: int, number: int, judged: Judgement) -> ev.PhotoChecked:
    return ev.PhotoChecked(
        shot=shot,
        attempt=number,
        verdict=judged.verdict.value,
        reason=judged.reason,
        sharpness=judged.sharpness,
        odd_deg=judged.odd_deg,
        error_deg=judged.error_deg,
        ties=tuple(
            ev.PhotoTie(shot=t.shot, points=t.points, angle_deg=t.angle_deg, parallax_deg=t.parallax_deg)
            for t in judged.ties
        ),
    )
