"""A shutter on a cable: nothing comes back, so that nobody but the mission keeps its interval."""

from __future__ import annotations

from itertools import pairwise

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.flying import fly
from tests.unit.fakes.world import World, some_settings


def _on_a_cable(world: World) -> None:
    world.camera.level = EvidenceLevel.COMMANDED


@pytest.mark.parametrize("brackets", [1, 3])
def test_its_camera_gets_the_time_that_it_needs_between_two_photos(brackets: int) -> None:
    settings = some_settings(min_evidence=EvidenceLevel.COMMANDED, interval_s=4.0, brackets=brackets)
    world = fly(prepare=_on_a_cable, settings=settings)
    assert world.record.state is MissionState.COMPLETE
    assert len(world.camera.photos) == 4 * brackets
    triggers = [photo.triggered_s for photo in world.camera.photos]
    assert min(b - a for a, b in pairwise(triggers)) >= 4.0 - 1e-6


def test_its_photos_are_commanded_and_nothing_more() -> None:
    world = fly(prepare=_on_a_cable, settings=some_settings(min_evidence=EvidenceLevel.COMMANDED))
    evidence = {shot.attempts[0].evidence for shot in world.record.shots.values()}
    assert evidence == {EvidenceLevel.COMMANDED}


def test_where_more_is_asked_for_none_of_them_counts() -> None:
    settings = some_settings(min_evidence=EvidenceLevel.ACKNOWLEDGED, attempts=1, rounds=1, evidence_s=0.5)
    world = fly(prepare=_on_a_cable, settings=settings)
    assert world.record.state is MissionState.INCOMPLETE
    assert world.record.shots_done == 0
    reason = world.record.shots[0].attempts[0].reason
    assert "only commanded after 0.5 s, acknowledged is required" in reason
