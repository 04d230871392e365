"""Faults of photos: which file gets which picture, and what is done to it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("PIL")

from panoexec.angles import angle_between, rotation
from panoexec.sim.faults import Faults, parse_fault
from panoexec.sim.photos.darkroom import ExposedPhoto
from panoexec.sim.photos.mixer import PhotoMixer
from panoexec.sim.photos.scene import procedural_scene
from panoexec.sim.photos.spoiling import spoiled_image
from panoexec.sim.physics.camera import Exposure
from panoexec.sim.physics.gimbal import Angles


def photo(number: int) -> ExposedPhoto:
    return ExposedPhoto(
        path=f"{number}.jpg",
        truth_deg=((float(number), 0.0, 0.0),),
        q_wxyz=(1.0, 0.0, 0.0, 0.0),
        time_utc_s=0.0,
        exposure_s=0.01,
        position=None,
        flight_yaw_deg=None,
    )


def developed(*faults: str, count: int = 4) -> list[ExposedPhoto]:
    out: list[ExposedPhoto] = []
    drawn = Faults([parse_fault(text) for text in faults], seed=1)
    mixer = PhotoMixer(drawn, out.append)
    for number in range(1, count + 1):
        drawn.photo_commanded(float(number))
        mixer.develop(photo(number))
    mixer.flush()
    return out


def pictures(found: list[ExposedPhoto]) -> dict[str, float]:
    return {one.path: one.truth_deg[0][0] for one in found}


def test_swapped_photos_have_each_others_pictures() -> None:
    assert pictures(developed("photo-swapped=#2")) == {"1.jpg": 1, "2.jpg": 3, "3.jpg": 2, "4.jpg": 4}


def test_photos_can_be_swapped_with_a_later_one() -> None:
    assert pictures(developed("photo-swapped=#1,x2")) == {"1.jpg": 3, "2.jpg": 2, "3.jpg": 1, "4.jpg": 4}


def test_a_photo_that_waits_for_another_one_is_rendered_at_the_end() -> None:
    assert pictures(developed("photo-swapped=#4")) == {f"{n}.jpg": n for n in range(1, 5)}


def test_a_stale_photo_is_marked_but_never_the_first() -> None:
    assert [one.is_stale for one in developed("photo-stale=#1,#3")] == [False, False, True, False]


def test_spoiled_photos_carry_fault_and_size() -> None:
    found = developed("photo-blur=4,#2", "photo-black=#3")
    assert [[name for name, _, _ in one.spoils] for one in found] == [[], ["photo-blur"], ["photo-black"], []]
    assert found[1].spoils[0][1] == 4.0


def test_a_lie_turns_the_camera_by_its_size() -> None:
    drawn = Faults([parse_fault("attitude-lie=1,#1")], seed=3)
    drawn.photo_commanded(0.0)
    pose = Angles(yaw_deg=30.0, roll_deg=0.0, pitch_deg=-40.0)
    exposure = Exposure(index=1, start_s=0.0, end_s=0.01, truth=(pose, pose), estimate=pose, measured=pose)
    moved = PhotoMixer(drawn, lambda _: None).turned(exposure)
    assert moved.measured == pose
    told = rotation(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    (first, second) = (rotation(a.yaw_deg, a.pitch_deg, a.roll_deg) for a in moved.truth)
    assert np.allclose(first, second)
    angle = np.degrees(np.arccos((np.trace(told.T @ first) - 1) / 2))
    assert angle == pytest.approx(1.0, abs=1e-6)
    assert angle_between(told[:, 0], first[:, 0]) <= 1.0 + 1e-9


def test_a_dark_picture_has_lost_that_many_stops_of_light() -> None:
    image = np.full((8, 8, 3), 200, dtype=np.uint8)
    dark = spoiled_image(image, "photo-dark", 2.0, seed=1)
    assert (dark[0, 0, 0] / 200) ** 2.2 == pytest.approx(0.25, abs=0.01)


def test_a_smear_keeps_edges_along_it_and_light() -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)
    blurred = spoiled_image(image, "photo-defocus", 6.0, seed=1)
    assert blurred.mean() == pytest.approx(image.mean(), abs=2.0)
    assert np.diff(blurred.astype(float), axis=0).std() < 0.3 * np.diff(image.astype(float), axis=0).std()


@pytest.mark.parametrize("kind", ["lake", "snow", "night"])
def test_scenes_of_little_texture_differ_from_the_city_on_the_ground(kind: str) -> None:
    def detail(name: str) -> float:
        ground = procedural_scene(5, 512, name).pixels[-60:].astype(float).mean(axis=2)
        return float(np.abs(np.diff(ground, axis=1)).mean())

    assert detail(kind) < 0.8 * detail("city")
