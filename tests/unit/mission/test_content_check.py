"""Verdicts on the content of photos: what is taken back, what is told, and which bridges are flown."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from panoexec.mission.bridging import MOST_BRIDGES, ROUNDS
from panoexec.mission.content_check import MOST_RETAKES
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.mission.log.shot_record import Verdict
from panoexec.pictures.model import BridgePose, Content
from panoexec.planning.model import GimbalLimits
from tests.unit.fakes.examination import SHOTS, Mission, be_quick


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    be_quick(monkeypatch)


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
