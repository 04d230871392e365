"""Files that store turned pixels, and orientation flags that are not to be believed."""

from __future__ import annotations

import pytest

from panoexec.exports.hugin import hugin_project
from panoexec.exports.model import ExportSet, ExportShot
from panoexec.exports.orientation import with_believed_orientation
from panoexec.optics import Camera

LANDSCAPE = Camera(
    name="x", sensor_width_mm=36.0, sensor_height_mm=24.0, image_width_px=6000, image_height_px=4000,
    focal_length_mm=35.0,
)  # fmt: skip


def shot(index: int, width: int, height: int, orientation: int, *, pitch_deg: float = 0.0) -> ExportShot:
    return ExportShot(
        index=index,
        row=0,
        q_wxyz=(1.0, 0.0, 0.0, 0.0),
        target_pitch_deg=pitch_deg,
        target_yaw_deg=0.0,
        width_px=width,
        height_px=height,
        orientation=orientation,
    )


@pytest.mark.parametrize(
    ("files", "portrait", "believed"),
    [
        # pixels stored as the profile says, and one flag near the nadir that the others contradict
        ([(6000, 4000, 1, 0), (6000, 4000, 1, -30), (6000, 4000, 6, -88), (6000, 4000, 3, -75)], False, [1, 1, 1, 1]),
        # the camera hangs upside down: most say so, and away from the nadir each is believed
        ([(6000, 4000, 3, 0), (6000, 4000, 3, -30), (6000, 4000, 1, -88), (6000, 4000, 1, 10)], False, [3, 3, 3, 1]),
        # pixels of the other format are turned by a quarter, as the flags say
        ([(4000, 6000, 8, 0), (4000, 6000, 8, -30), (4000, 6000, 1, -90), (4000, 6000, 6, -88)], False, [8, 8, 8, 8]),
        ([(4000, 6000, 1, 0), (4000, 6000, 1, -30)], False, [6, 6]),
        # mounted upright: stored as the sensor reads, or as it is looked at
        ([(6000, 4000, 6, 0), (6000, 4000, 6, -30), (6000, 4000, 1, -85)], True, [6, 6, 6]),
        ([(4000, 6000, 1, 0), (4000, 6000, 8, -85)], True, [1, 1]),
        # a quarter that would give the other format is not believed
        ([(6000, 4000, 6, 0), (6000, 4000, 6, -30)], False, [1, 1]),
        # only steep photos: most of them
        ([(6000, 4000, 3, -90), (6000, 4000, 3, -80), (6000, 4000, 1, -85)], False, [3, 3, 3]),
    ],
)
def test_what_is_believed(files: list[tuple[int, int, int, float]], portrait: bool, believed: list[int]) -> None:
    camera = LANDSCAPE.rotated() if portrait else LANDSCAPE
    shots = [shot(i, w, h, flag, pitch_deg=pitch) for i, (w, h, flag, pitch) in enumerate(files)]
    assert [one.orientation for one in with_believed_orientation(shots, camera)] == believed


def test_files_that_were_not_seen_stay_as_they_are() -> None:
    assert with_believed_orientation([shot(0, 0, 0, 6)], LANDSCAPE)[0].orientation == 6


def test_a_landscape_camera_that_stores_portrait_pixels_keeps_its_field_of_view() -> None:
    shots = with_believed_orientation([shot(0, 4000, 6000, 8), shot(1, 4000, 6000, 1, pitch_deg=-90)], LANDSCAPE)
    project = hugin_project(ExportSet(title="", camera=LANDSCAPE, shots=shots))
    assert [image.roll_deg for image in project.images] == [-90, -90]
    assert {(image.width_px, image.height_px) for image in project.images} == {(4000, 6000)}
    assert project.hfov_deg == pytest.approx(LANDSCAPE.vfov_deg), "across the stored width"
