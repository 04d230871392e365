import math

import pytest

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.raycast import paper_grid, raycast_overlap, relaxation_deg
from panoexec.planning.geometry.overlap import pairwise_overlap

CAMERA = Camera.from_fov(59.94, 46.86)


def test_the_papers_grid_has_a_pixel_for_each_step_of_the_gimbal() -> None:
    assert paper_grid(CAMERA) == (3526, 2757)


def test_the_relaxation_is_equation_6s_angle() -> None:
    assert math.cos(math.radians(relaxation_deg())) == pytest.approx(
        math.cos(math.sqrt(2 * math.radians(0.017) ** 2 + math.radians(0.667) ** 2))
    )


def test_equation_6_reports_more_overlap_the_worse_the_gimbal_is() -> None:
    """Why no guarantee may rest on it."""
    a, b = rotation(0.0, 0.0), rotation(0.0, 40.3)
    exact = float(pairwise_overlap(CAMERA, a, b))
    reported = [
        raycast_overlap(CAMERA, a, b, grid=(200, 200), relaxed_by_deg=relaxation_deg(0.017, yaw))
        for yaw in (0.1, 1.0, 5.0)
    ]
    assert exact < 0.15
    assert exact < reported[0] < reported[1] < reported[2]
    # a strip of the relaxation's width along B's lower edge is added
    assert reported[2] - exact > 0.08


def test_a_ray_just_off_an_image_counts_only_when_relaxed_enough() -> None:
    a, b = rotation(0.0, 0.0), rotation(0.0, 60.0)
    apart = 60.0 - CAMERA.vfov_deg  # of the middles of the two edges; the corners are about 1° nearer
    assert raycast_overlap(CAMERA, a, b, grid=(50, 50)) == 0.0
    assert raycast_overlap(CAMERA, a, b, grid=(50, 50), relaxed_by_deg=apart - 2.0) == 0.0
    assert raycast_overlap(CAMERA, a, b, grid=(50, 50), relaxed_by_deg=apart + 1.0) > 0.0


def test_images_of_two_cameras() -> None:
    narrow = Camera.from_fov(20, 15)
    inside = raycast_overlap(narrow, rotation(0.0, 0.0), rotation(0.0, 0.0), grid=(30, 30), camera_b=CAMERA)
    assert inside == 1.0
