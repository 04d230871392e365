"""Verdicts on the content of photos: what is taken back, what is told, and what a failed examination does."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.errors import DeviceError
from panoexec.mission.bridging import MOST_BRIDGES, ROUNDS
from panoexec.mission.content_check import MOST_RETAKES, ContentCheck, PictureSource
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.mission.shot_queue import ShotQueue
from panoexec.optics import Camera
from panoexec.pictures.model import BridgePose, Content, Judgement, TieGraph, TieLine, Verdicts
from panoexec.planning.model import GimbalLimits, Shot
from panoexec.store import manifest

SHOTS = tuple(Shot(index=k, row=0, pitch_deg=-30.0, yaw_deg=60.0 * k - 180) for k in range(6))


class Checker:
    """A scripted examination."""

    def __init__(self) -> None:
        self.bad: dict[int, Content] = {}
        self.added: list[int] = []
        self.broken = False
        self.wished: list[BridgePose] = []
        self.edges: tuple[tuple[int, int, int], ...] = ()
        self.limits: tuple[float, float] | None = None

    async def plan(self, planned: Mapping[int, Sequence[float]]) -> None:
        self.planned = dict(planned)

    async def add(
        self, shot: int, path: Path, q_wxyz: Sequence[float], time_s: float, place: Sequence[float] | None = None
    ) -> Verdicts:
        del path, q_wxyz, time_s, place
        if self.broken:
            raise DeviceError("gone")
        self.added.append(shot)
        return await self.judge()

    async def condemn(self, shot: int, code: Content, reason: str, q_wxyz: Sequence[float], time_s: float) -> Verdicts:
        del reason, q_wxyz, time_s
        self.bad[shot] = code
        self.added.append(shot)
        return await self.judge()

    async def drop(self, shots: Sequence[int]) -> Verdicts:
        self.added = [shot for shot in self.added if shot not in shots]
        return await self.judge()

    async def judge(self, *, final: bool = False) -> Verdicts:
        del final
        photos = {
            shot: Judgement(
                shot=shot,
                verdict=self.bad.get(shot, Content.OK),
                reason="bad" if shot in self.bad else "",
                ties=(TieLine(shot=0, points=9, angle_deg=0.1),),
            )
            for shot in self.added
        }
        good = tuple(shot for shot in photos if shot not in self.bad)
        graph = TieGraph(photos=good, groups=(good,) if good else (), edges=self.edges)
        return Verdicts(photos=photos, graph=graph)

    async def bridges(
        self, *, tried: Collection[frozenset[int]], pitch_deg: tuple[float, float], most: int
    ) -> list[BridgePose]:
        self.limits = pitch_deg
        return [one for one in self.wished if frozenset(one.between) not in tried][:most]


class Mission:
    """What the check needs of a mission: a record with accepted photos, and a recorder."""

    def __init__(self, folder: Path, pictures: str = "retake") -> None:
        from types import SimpleNamespace  # noqa: PLC0415

        self.record = MissionRecord(mission_id="m", shots=SHOTS)
        self.events: list[ev.Event] = []
        self.revoked: list[tuple[int, int, str]] = []
        self.folder = folder
        self.checker = Checker()
        requests = SimpleNamespace(stop=None, must_end_shooting=False)
        self.requests = requests
        from panoexec.clock import SystemClock  # noqa: PLC0415

        self.context = SimpleNamespace(
            record=self.record,
            plan=SimpleNamespace(camera=Camera.from_fov(60, 45)),
            settings=SimpleNamespace(pictures=pictures, gimbal=GimbalLimits(pitch_min_deg=-70.0)),
            gimbal=SimpleNamespace(limits=None),
            recorder=SimpleNamespace(emit=self.emit),
            requests=requests,
            queue=ShotQueue([], attempts=9, rounds=9),
            clock=SystemClock(),
        )
        self.check = ContentCheck(
            self.context,  # type: ignore[arg-type]
            PictureSource(folder=folder, open=self.opened),
            self.revoke,
        )

    @asynccontextmanager
    async def opened(self, camera: Camera) -> AsyncIterator[Checker]:
        del camera
        yield self.checker

    def emit(self, event: ev.Event) -> ev.Event:
        stamped = replace(event, seq=self.record.seq + 1, mission_id="m", time_utc_s=0.0, clock_s=0.0)
        self.record.apply(stamped)
        self.events.append(stamped)
        return stamped

    def revoke(self, shot: int, number: int, code: str, reason: str, photos: tuple[ev.Photo, ...]) -> None:
        self.revoked.append((shot, number, code))
        self.context.queue.add(shot)
        self.emit(ev.ShotRevoked(shot=shot, attempt=number, code=code, reason=reason, photos=photos))

    def accept(self, shot: int, *, stored: bool = True, taken_s: float = math.nan) -> None:
        self.context.queue.clear()
        number = len(self.record.shots[shot].attempts) + 1
        self.emit(ev.ShotStarted(shot=shot, attempt=number, round=0, pitch_deg=0.0, yaw_deg=0.0, patience_s=1.0))
        self.emit(
            ev.ShotExposed(
                shot=shot, attempt=number, photos=(), pointing_ok=True, reason="", samples=1, measured=None,
                errors=None, slew_settle_s=0.0, trigger_delay_s=0.0,
            )
        )  # fmt: skip
        self.emit(ev.ShotAccepted(shot=shot, attempt=number, photos=(), by="tolerance"))
        if stored:
            name = f"images/{shot}-{number}.jpg"
            (self.folder / "images").mkdir(exist_ok=True)
            (self.folder / name).write_bytes(b"x")
            self.emit(
                ev.PhotoStored(
                    shot=shot,
                    attempt=number,
                    file=name,
                    size_bytes=1,
                    sha256=f"{shot}{number}" * 32,
                    source="local",
                    taken_s=taken_s,
                    taken_resolution_s=1.0,
                )
            )

    async def checked(self) -> None:
        """Examine everything that is here, and judge it."""
        self.check._ended = False
        running = asyncio.create_task(self.check.run())
        try:
            while self.check._checker is None:  # noqa: ASYNC110
                await asyncio.sleep(0)
            await self.check.settle()
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)

    def kinds(self) -> list[str]:
        return [event.type for event in self.events]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.mission.content_check._LOOK_S", 0.001)
    monkeypatch.setattr("panoexec.mission.content_check._NO_FILE_S", 0.05)
    monkeypatch.setattr("panoexec.mission.content_check._NO_MORE_S", 0.05)


async def test_good_photos_are_told_and_judged(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    await mission.checked()
    assert not mission.revoked
    assert [mission.record.shots[k].attempts[0].checked.verdict for k in range(6)] == ["ok"] * 6  # type: ignore[union-attr]
    assert mission.record.content is not None
    assert mission.record.content.groups == 1
    assert not mission.record.content.unchecked
    assert not mission.record.bad_photos()


async def test_a_bad_photo_is_taken_back_with_its_code(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.checker.bad[2] = Content.BLURRED
    await mission.checked()
    assert mission.revoked == [(2, 1, "blurred")]
    assert mission.record.shots[2].attempts[0].verdict is Verdict.REJECTED
    assert mission.record.content is None, "the mission goes on"
    del mission.checker.bad[2]
    mission.accept(2)
    await mission.checked()
    assert mission.record.content is not None
    assert not mission.record.bad_photos()


async def test_what_content_and_its_own_time_contradict_never_stays_accepted(tmp_path: Path) -> None:
    mission = Mission(tmp_path, pictures="warn")
    for shot in range(6):  # all at one moment of the mission's clock
        mission.accept(shot, taken_s=1e9 + (40 if shot in {1, 3} else 0))
    mission.checker.bad |= {1: Content.CONTRADICTS, 2: Content.CONTRADICTS, 3: Content.BLURRED}
    await mission.checked()
    assert mission.revoked == [(1, 1, "contradicts")]
    assert mission.record.shots[1].attempts[0].verdict is Verdict.REJECTED
    assert "bad; its file tells that it was taken at least" in mission.record.shots[1].attempts[0].reason
    (warning,) = mission.record.warnings
    assert warning.startswith("1 photos contradict the time of their trigger: shot 3")


async def test_a_warning_takes_nothing_back_but_the_photo_does_not_count(tmp_path: Path) -> None:
    mission = Mission(tmp_path, pictures="warn")
    mission.accept(0)
    mission.checker.bad[0] = Content.CONTRADICTS
    await mission.checked()
    assert not mission.revoked
    assert mission.record.bad_photos() == {0: "contradicts"}
    assert mission.record.content is not None
    assert mission.record.content.bad == (0,)


async def test_a_photo_that_late_evidence_took_back_says_nothing_of_its_neighbours(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.checker.edges = ((2, 3, 9),)
    await mission.checked()
    assert mission.checker.added
    mission.emit(ev.ShotRevoked(shot=2, attempt=1, code="late", reason="exposed while the gimbal moved", photos=()))
    await mission.checked()
    assert sorted(mission.checker.added) == [0, 1, 3, 4, 5]
    mission.accept(2)
    await mission.checked()
    assert sorted(mission.checker.added) == [0, 1, 2, 3, 4, 5]
    assert mission.record.content is not None
    assert not mission.record.content.unchecked


async def test_a_shot_is_not_taken_again_for_ever(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.checker.bad[0] = Content.UNTIED
    for _ in range(MOST_RETAKES + 1):
        mission.accept(0)
        await mission.checked()
    assert len(mission.revoked) == MOST_RETAKES
    assert mission.record.bad_photos() == {0: "untied"}


async def test_when_most_photos_are_bad_none_is_taken_again(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
        if shot < 4:
            mission.checker.bad[shot] = Content.CONTRADICTS
    running = asyncio.create_task(mission.check.run())
    await asyncio.sleep(0.05)
    await mission.check.settle()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    last = set(mission.record.bad_photos())
    assert last or mission.revoked, "bad photos are never silently accepted"


def bridge(a: int, b: int) -> BridgePose:
    return BridgePose(between=(a, b), pitch_deg=-33.0, yaw_deg=10.0 * a, corners=30)


async def test_a_bridge_is_planned_flown_and_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.checker.wished = [bridge(1, 2)]
    await mission.checked()
    assert mission.checker.limits == (-70.0, 90.0)
    assert mission.kinds()[-1] == "bridge_planned"
    assert mission.record.content is None, "the mission goes on"
    added = mission.record.shots[6]
    assert (added.between, added.shot.row, added.shot.pitch_deg, added.shot.yaw_deg) == ((1, 2), -1, -33.0, 10.0)
    assert 6 in mission.context.queue
    mission.accept(6)
    mission.checker.edges = ((1, 6, 20), (2, 6, 20))
    await mission.checked()
    assert mission.record.bridge_ties() == {6: (1, 2)}
    assert not mission.record.warnings
    # a new process folds the same events into the same mission: the bridge is not planned again
    again = MissionRecord.from_events(mission_id="m", shots=SHOTS, events=mission.events)
    assert (again.shots[6].between, again.bridge_rounds) == ((1, 2), 1)


async def test_a_bridge_that_ties_only_one_side_is_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(3):
        mission.accept(shot)
    mission.checker.wished = [bridge(1, 2)]
    await mission.checked()
    mission.accept(6)
    mission.checker.edges = ((1, 6, 20),)
    await mission.checked()
    assert mission.record.bridge_ties() == {6: (1,)}
    assert mission.record.warnings == [
        "shots 1 and 2 show texture but share too little; bridge shot 6 ties shot 1 alone"
    ]


async def test_bridges_are_bounded_whatever_is_wished(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.checker.wished = [bridge(a, b) for a in range(6) for b in range(a)]
    for _ in range(ROUNDS + 3):
        await mission.checked()
        for shot in [index for index, one in mission.record.shots.items() if one.between and one.accepted is None]:
            mission.accept(shot)
    planned = [event for event in mission.events if isinstance(event, ev.BridgePlanned)]
    pairs = [pair for event in planned for pair in zip(event.between[::2], event.between[1::2], strict=True)]
    assert len(planned) <= ROUNDS
    assert len(pairs) == len(set(pairs)) == MOST_BRIDGES
    assert mission.record.content is not None


async def test_a_pose_that_the_gimbal_cannot_pan_to_is_no_bridge(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.context.settings.gimbal = GimbalLimits(yaw_min_deg=-5.0, yaw_max_deg=25.0, yaw_endless=False)
    mission.checker.wished = [bridge(4, 5), bridge(5, 3)]
    await mission.checked()
    assert "bridge_planned" not in mission.kinds()
    assert mission.record.content is not None


async def test_a_second_untied_photo_waits_for_its_bridge_and_is_taken_again_if_that_fails(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(6):
        mission.accept(shot)
    mission.checker.bad[2] = Content.UNTIED
    mission.checker.wished = [bridge(1, 2)]
    await mission.checked()
    assert mission.revoked == [(2, 1, "untied")], "first it is taken again"
    mission.accept(2)
    await mission.checked()
    assert len(mission.revoked) == 1
    assert 6 in mission.context.queue
    mission.accept(6)
    await mission.checked()
    assert mission.revoked == [(2, 1, "untied"), (2, 2, "untied")]


async def test_a_bad_bridge_is_given_up_and_nothing_hangs_on_it(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    for shot in range(3):
        mission.accept(shot)
    mission.checker.wished = [bridge(1, 2)]
    await mission.checked()
    mission.checker.bad[6] = Content.UNTIED
    mission.accept(6)
    await mission.checked()
    assert mission.revoked == [(6, 1, "untied")]
    mission.accept(6)
    await mission.checked()
    assert mission.record.shots[6].accepted is None
    assert mission.record.content is not None
    assert mission.record.content.bad == ()
    assert not mission.record.bad_photos()
    assert mission.record.bridge_ties() == {6: ()}
    assert "neither of them" in mission.record.warnings[0]


async def test_no_bridge_is_flown_where_nothing_is_taken_again(tmp_path: Path) -> None:
    mission = Mission(tmp_path, pictures="warn")
    for shot in range(3):
        mission.accept(shot)
    mission.checker.wished = [bridge(1, 2)]
    await mission.checked()
    assert "bridge_planned" not in mission.kinds()
    assert mission.record.content is not None


async def test_photos_that_do_not_arrive_are_unchecked(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.accept(1, stored=False)
    await mission.checked()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (1,)
    assert mission.record.shots[1].accepted is not None


async def test_an_examination_that_begins_late_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine starts its process late: the files are there, and a mission does not end as if all were good."""
    monkeypatch.setattr("panoexec.mission.content_check._NO_MORE_S", 60.0)
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.check._ended = False
    settling = asyncio.create_task(mission.check.settle())
    await asyncio.sleep(0.2)  # four times the wait for a first file
    assert not settling.done()
    running = asyncio.create_task(mission.check.run())
    await settling
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert mission.record.content is not None
    assert "warned" not in mission.kinds()


async def test_an_examination_that_never_begins_is_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.accept(1)
    mission.check._ended = False
    await mission.check.settle()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0, 1)
    written = manifest._content_json(mission.record)
    assert (written["certified"], written["connected"], written["unchecked"]) == (False, False, [0, 1])
    (warned,) = [event for event in mission.events if isinstance(event, ev.Warned)]
    assert warned.text == "the content of photos is not checked: of 2 files none could be examined in time"


async def test_a_judgement_that_fails_is_told(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    judge = mission.checker.judge

    async def fails_at_the_end(*, final: bool = False) -> Verdicts:
        if final:
            raise DeviceError("gone")
        return await judge()

    mission.checker.judge = fails_at_the_end  # type: ignore[method-assign]
    await mission.checked()
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0,)
    (warned,) = [event for event in mission.events if isinstance(event, ev.Warned)]
    assert warned.text == "the content of photos is not checked: gone"


async def test_a_failed_examination_warns_and_ends_nothing(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0)
    mission.checker.broken = True
    await mission.check.run()
    assert mission.kinds()[-1] == "warned"
    await mission.check.settle()
    await mission.check.settle()
    assert mission.kinds()[-2:] == ["warned", "content_judged"]
    assert mission.record.content is not None
    assert mission.record.content.unchecked == (0,)


async def test_a_refused_file_is_unreadable_or_another_shots(tmp_path: Path) -> None:
    mission = Mission(tmp_path)
    mission.accept(0, stored=False)
    mission.accept(1, stored=False)
    refused = {(0, 1): "a.jpg: cut off", (1, 1): "b.jpg: is the photo of shot 0, attempt 1, too (images/a.jpg)"}
    mission.check._source = replace(mission.check._source, refused=lambda: refused)  # type: ignore[type-var]
    running = asyncio.create_task(mission.check.run())
    while len(mission.revoked) < 2:  # noqa: ASYNC110
        await asyncio.sleep(0.001)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    assert sorted(mission.revoked) == [(0, 1, "unreadable"), (1, 1, "contradicts")]
