"""Photos with known truth: what is bad is named, what is good is tied where it is."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import FloatArray, rotation
from panoexec.pictures.examiner import Examiner
from panoexec.pictures.model import BAD, Content, PhotoToCheck, Verdicts
from panoexec.pictures.rotations import rotation_of_vector
from panoexec.planning.model import Plan
from tests.support.photo_sets import PhotoSet, photo_set
from tests.unit.pictures.conftest import SCENE


def examine(plan: Plan, photos: PhotoSet) -> tuple[Examiner, Verdicts]:
    planned = {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in plan.shots}
    examiner = Examiner(plan.camera, planned)
    for photo in photos.photos:
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
    return examiner, examiner.verdicts(final=True)


def true_turn(first: FloatArray, second: FloatArray, true_first: FloatArray, true_second: FloatArray) -> FloatArray:
    """Measured minus true attitude of the second, if the first's were right; world frame, degrees."""
    error = second @ (first @ true_first.T @ true_second).T
    axis = np.array([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]])
    return np.asarray(np.degrees(axis / 2))


@pytest.fixture(scope="module")
def clean(two_rows: Plan) -> PhotoSet:
    return photo_set(two_rows, seed=1, **SCENE)


def test_clean_photos_are_tied_where_they_are(two_rows: Plan, clean: PhotoSet) -> None:
    examiner, verdicts = examine(two_rows, clean)
    assert {found.verdict for found in verdicts.photos.values()} == {Content.OK}
    assert verdicts.graph.connected
    assert not verdicts.graph.bridges
    assert len(examiner.ties) >= 24
    for (a, b), tie in examiner.ties.items():
        if tie.tied:
            one, other = clean.photos[a], clean.photos[b]
            turn = true_turn(one.measured, other.measured, one.truth, other.truth)
            assert np.linalg.norm(turn - tie.turn_world_deg) < 0.05 + 4 * tie.sigma_deg, (a, b)


def test_the_error_of_each_attitude_is_estimated(two_rows: Plan, clean: PhotoSet) -> None:
    _, verdicts = examine(two_rows, clean)
    tilt = []
    for photo in clean.photos:
        error = photo.measured @ photo.truth.T
        north, east = np.degrees([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0]]) / 2
        told = verdicts.photos[photo.shot].error_deg
        tilt.append(np.hypot(told[0] - north, told[1] - east))
    assert np.sqrt(np.mean(np.square(tilt))) < 0.03


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("photo-black", Content.EXPOSURE),
        ("photo-dark=3", Content.EXPOSURE),
        ("photo-blur=5", Content.BLURRED),
        ("photo-defocus=5", Content.BLURRED),
        ("photo-truncated", Content.UNREADABLE),
        ("photo-damaged", Content.UNREADABLE),
        ("photo-swapped", Content.CONTRADICTS),
        ("photo-stale", Content.CONTRADICTS),
        ("attitude-lie=1", Content.CONTRADICTS),
    ],
)
def test_a_bad_photo_is_named_and_no_other(two_rows: Plan, fault: str, code: Content) -> None:
    photos = photo_set(two_rows, seed=2, faults={3: fault}, **SCENE)
    _, verdicts = examine(two_rows, photos)
    bad = {found.shot for found in verdicts.bad}
    assert bad == {photo.shot for photo in photos.photos if photo.fault}
    assert verdicts.photos[3].verdict is code
    assert all(found.reason for found in verdicts.bad)


@pytest.mark.parametrize("bias_deg", [(0.0, 0.6, 0.0), (0.0, -0.35, 0.5)])
def test_a_constant_error_of_the_gimbal_contradicts_nothing(
    two_rows: Plan, bias_deg: tuple[float, float, float]
) -> None:
    """Yaw, pitch, roll: neither at the end nor while the photos arrive; and it is told."""
    photos = photo_set(two_rows, seed=1, bias_deg=bias_deg, faults={9: "attitude-lie=1"}, **SCENE)
    planned = {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in two_rows.shots}
    examiner = Examiner(two_rows.camera, planned)
    for photo in photos.photos:
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
        early = [found for found in examiner.verdicts().bad if found.settled]
        assert {found.shot for found in early} <= {9}, [found.reason for found in early]
    verdicts = examiner.verdicts(final=True)
    assert [found.shot for found in verdicts.bad] == [9], "a lie is found all the same"
    for photo in photos.photos:
        if photo.shot == 9:
            continue
        told = np.radians(verdicts.photos[photo.shot].error_deg)
        true = photo.truth
        refined = rotation_of_vector(-told) @ photo.measured
        up = np.degrees(np.arccos(np.clip(refined[2] @ true[2], -1, 1)))
        assert up < 0.06, "tilt; a common heading error leaves no trace"


def test_all_photos_one_place_off_are_refused(two_rows: Plan, clean: PhotoSet) -> None:
    contents = [photo.content for photo in clean.photos]
    shifted = [
        replace(photo, content=contents[(number + 1) % len(contents)]) for number, photo in enumerate(clean.photos)
    ]
    _, verdicts = examine(two_rows, replace(clean, photos=shifted))
    assert len(verdicts.bad) > len(shifted) / 2


def test_water_hangs_on_geometry_alone(two_rows: Plan) -> None:
    photos = photo_set(two_rows, seed=3, kind="lake", **SCENE)
    examiner, verdicts = examine(two_rows, photos)
    assert not verdicts.bad
    loose = set(verdicts.graph.geometry_only)
    assert loose
    assert loose <= {shot.index for shot in two_rows.shots if shot.row == 1}, "the lower row looks at water"
    # the bound of their attitude error holds for their true attitudes, the heading relative to the tied photos
    turns = {photo.shot: photo.measured @ photo.truth.T for photo in photos.photos}
    axes = {
        shot: np.degrees([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
        for shot, off in turns.items()
    }
    heading = float(np.mean([axis[2] for shot, axis in axes.items() if shot not in loose]))
    for shot in loose:
        assert np.linalg.norm(axes[shot] - [0, 0, heading]) <= verdicts.geometry_bound_deg < 2.2
    for shot in loose:
        assert not any(tie.tied for pair, tie in examiner.ties.items() if shot in pair)


def test_without_ties_the_bound_is_what_attitudes_are_expected_to_err() -> None:
    assert Verdicts().geometry_bound_deg == 2.2


def test_verdicts_wait_for_the_neighbours(two_rows: Plan) -> None:
    photos = photo_set(two_rows, seed=2, faults={1: "attitude-lie=1"}, **SCENE)
    planned = {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in two_rows.shots}
    examiner = Examiner(two_rows.camera, planned)
    told: dict[int, int] = {}
    for count, photo in enumerate(photos.photos, start=1):
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), photo.content)
        for shot, found in examiner.verdicts().photos.items():
            if found.verdict in BAD and found.settled:
                told.setdefault(shot, count)
    assert told.keys() == {1}
    assert told[1] <= 4, "two photos that contradict each other do not tell which of them is wrong; the next ones do"


def test_a_retake_replaces_the_photo(two_rows: Plan, clean: PhotoSet) -> None:
    photos = photo_set(two_rows, seed=1, faults={3: "photo-blur=6"}, **SCENE)
    examiner, verdicts = examine(two_rows, photos)
    assert [found.shot for found in verdicts.bad] == [3]
    again = clean.photos[3]
    examiner.add(PhotoToCheck(shot=3, rotation=again.measured, time_s=again.time_s), again.content)
    assert not examiner.verdicts(final=True).bad


def test_a_photo_of_another_size_is_not_compared(two_rows: Plan, clean: PhotoSet) -> None:
    small = photo_set(two_rows, seed=1, **SCENE | {"width_px": 300})
    photos = [*clean.photos[:4], small.photos[4], *clean.photos[5:]]
    _, verdicts = examine(two_rows, replace(clean, photos=photos))
    assert verdicts.photos[4].verdict is Content.UNREADABLE
    assert "300 x" in verdicts.photos[4].reason
    assert [found.shot for found in verdicts.bad] == [4]


def test_photos_beyond_the_memory_are_tied_too(
    two_rows: Plan, clean: PhotoSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoexec.pictures.examiner._IN_MEMORY", 3)
    examiner, verdicts = examine(two_rows, clean)
    assert {found.verdict for found in verdicts.photos.values()} == {Content.OK}
    assert sum(tie.tied for tie in examiner.ties.values()) >= 24


def _smaller(content: bytes) -> bytes:
    """A preview instead of the photo."""
    with PIL.Image.open(io.BytesIO(content)) as picture:
        out = io.BytesIO()
        picture.resize((picture.width // 2, picture.height // 2)).save(out, "JPEG", quality=90)
        return out.getvalue()


@pytest.mark.parametrize("odd", [0, 3])
def test_a_photo_of_another_size_is_named_even_if_it_is_the_first(two_rows: Plan, clean: PhotoSet, odd: int) -> None:
    """All the others were `unreadable` because of a first one."""
    photos = [replace(one, content=_smaller(one.content)) if one.shot == odd else one for one in clean.photos]
    _, verdicts = examine(two_rows, replace(clean, photos=photos))
    assert [(one.shot, one.verdict) for one in verdicts.bad] == [(odd, Content.UNREADABLE)]
    assert "px, the others" in verdicts.photos[odd].reason


def test_of_two_sizes_the_one_that_comes_again_counts(two_rows: Plan, clean: PhotoSet) -> None:
    """A mission drops what is bad, and takes it again."""
    planned = {shot.index: rotation(shot.yaw_deg, shot.pitch_deg) for shot in two_rows.shots}
    examiner = Examiner(two_rows.camera, planned)
    first, second = (
        (PhotoToCheck(shot=one.shot, rotation=one.measured, time_s=one.time_s), one.content) for one in clean.photos[:2]
    )
    examiner.add(first[0], _smaller(first[1]))
    examiner.add(*second)
    assert [one.shot for one in examiner.verdicts().bad] == [second[0].shot]
    examiner.drop(second[0].shot)
    examiner.add(*second)
    assert [one.shot for one in examiner.verdicts().bad] == [first[0].shot]
    examiner.drop(first[0].shot)
    examiner.add(*first)
    assert not examiner.verdicts().bad
    assert examiner.ties[first[0].shot, second[0].shot].tied


def test_a_photo_of_the_size_of_the_profile_counts_at_once(two_rows: Plan, clean: PhotoSet) -> None:
    one, other = clean.photos[:2]
    with PIL.Image.open(io.BytesIO(other.content)) as picture:
        camera = replace(two_rows.camera, image_width_px=picture.width, image_height_px=picture.height)
    examiner = Examiner(camera)
    for photo, content in ((one, _smaller(one.content)), (other, other.content)):
        examiner.add(PhotoToCheck(shot=photo.shot, rotation=photo.measured, time_s=photo.time_s), content)
    assert [found.shot for found in examiner.verdicts().bad] == [one.shot]
