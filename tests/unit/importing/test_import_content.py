"""Photos of a scene: the right pairing is confirmed, and one that times alone would believe is refused."""

from __future__ import annotations

import random
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from panoexec.angles import rotation
from panoexec.importing.card_import import ContradictedCardError, plan_import
from panoexec.sim.photos.jpeg import PhotoMetadata, jpeg_bytes
from panoexec.sim.photos.render import Renderer
from panoexec.sim.photos.scene import procedural_scene
from tests.unit.fakes.world import a_plan
from tests.unit.importing.cards import Taken, a_mission, take

SHOTS = 10


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    plan, renderer = a_plan(SHOTS, pitch_deg=-35.0), Renderer(procedural_scene(3))
    return [renderer.render(plan.camera, rotation([s.yaw_deg], [s.pitch_deg], [0.0]), 400) for s in plan.shots]


def _fill(card: Path, taken: list[Taken], pictures: list[np.ndarray], *, shift: int) -> None:
    """Write a card; with a shift each photo shows what the next attempts saw."""
    card.mkdir()
    rng = random.Random(1)
    for number, one in enumerate(taken):
        metadata = PhotoMetadata(
            time_utc_s=datetime.fromtimestamp(one.time_s + rng.uniform(0.1, 0.3), UTC).timestamp() + 7200,
            exposure_s=0.01,
            focal_length_mm=15.0,
            equivalent_focal_length_mm=30.0,
            q_wxyz=(1.0, 0.0, 0.0, 0.0),
        )
        picture = pictures[taken[(number + shift) % SHOTS].shot]
        (card / f"DSC{number:05d}.JPG").write_bytes(jpeg_bytes(picture, metadata))


def test_content_confirms_or_refuses_a_pairing(tmp_path: Path, pictures: list[np.ndarray]) -> None:
    # not round and round: in one row of equal steps a card that is one off only turns the panorama
    order = (0, 3, 7, 1, 8, 5, 2, 9, 4, 6)
    times = [one.time_s for one in take(SHOTS + 1, seed=6)]
    taken = [Taken(shot, 1, time_s, accepted=True) for shot, time_s in zip(order, times, strict=False)]
    directory = a_mission(tmp_path, taken, measured=True, pitch_deg=-35.0)
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    _fill(right, taken, pictures, shift=0)
    found = plan_import(directory, right)
    assert found.content == f"content: {SHOTS} of {SHOTS} photos are tied to their neighbours, 0 contradict them"
    _fill(wrong, taken, pictures, shift=1)
    with pytest.raises(ContradictedCardError, match=r"the content of \d+ photos contradicts the pairing"):
        plan_import(directory, wrong)
