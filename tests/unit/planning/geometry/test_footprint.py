import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import direction, rotation
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import corner_rays, edge_normals, inside_margin, outline, rectangle

fov = st.floats(0.5, 179.0)
cameras = st.builds(Camera.from_fov, fov, fov)
yaws = st.floats(-180, 180)
pitches = st.floats(-90, 90)


@given(cameras)
def test_edges_run_clockwise_from_corner_to_corner(camera: Camera) -> None:
    corners, normals = corner_rays(camera), edge_normals(camera)
    for i in range(4):
        across = np.cross(corners[i], corners[(i + 1) % 4])
        # the inward normal of the edge's great circle; clockwise as the viewer sees it
        assert across / np.linalg.norm(across) == pytest.approx(normals[i], abs=1e-9)
    assert corners[0] @ [0, 1, 0] < 0 < corners[1] @ [0, 1, 0]  # left of the right one
    assert corners[1] @ [0, 0, 1] < 0 < corners[2] @ [0, 0, 1]  # z points down: the top is negative


@given(cameras, st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_four_half_spaces_are_enough(camera: Camera, vector: list[float]) -> None:
    """Inside all four edge planes implies in front of the camera, so no fifth condition is needed."""
    v = np.array(vector)
    if np.linalg.norm(v) < 1e-6:
        return
    inside = bool((edge_normals(camera) @ v >= 1e-12).all())
    in_front = bool(v[0] > 0)
    in_rectangle = in_front and abs(v[1]) <= camera.half_width * v[0] and abs(v[2]) <= camera.half_height * v[0]
    if inside:
        assert in_front
        assert in_rectangle
    # strictly inside the rectangle by a margin far above rounding
    if in_front and abs(v[1]) < 0.999 * camera.half_width * v[0] and abs(v[2]) < 0.999 * camera.half_height * v[0]:
        assert (edge_normals(camera) @ v > 0).all()


@given(cameras, yaws, pitches, st.integers(1, 9))
def test_the_outline_is_the_border(camera: Camera, yaw: float, pitch: float, points: int) -> None:
    turn = rotation(yaw, pitch)
    border = outline(camera, turn, points)
    assert border.shape == (4 * points, 3)
    assert np.linalg.norm(border, axis=1) == pytest.approx(1.0)
    assert inside_margin(camera, turn, border) == pytest.approx(0.0, abs=1e-9)
    assert border[::points] == pytest.approx(corner_rays(camera) @ turn.T, abs=1e-12)


def test_the_outline_takes_many_images_at_once() -> None:
    camera = Camera.from_fov(40, 30)
    turns = rotation(np.array([0.0, 90.0]), np.array([10.0, -20.0]))
    together = outline(camera, turns, 5)
    assert together.shape == (2, 20, 3)
    assert together[1] == pytest.approx(outline(camera, turns[1], 5))


def test_the_margin_is_the_angle_to_the_border() -> None:
    camera = Camera.from_fov(60, 40)
    turn = rotation(30.0, -10.0)
    assert inside_margin(camera, turn, direction(-10.0, 30.0)) == pytest.approx(np.sin(np.radians(20)))
    above = direction(-10.0 + 25.0, 30.0)
    assert inside_margin(camera, turn, above) == pytest.approx(-np.sin(np.radians(5)))
    assert inside_margin(camera, turn, -direction(-10.0, 30.0)) < 0


def test_the_rectangle_is_as_wide_as_the_field_of_view() -> None:
    camera = Camera.from_fov(90, 60)
    assert rectangle(camera)[1] == pytest.approx([1.0, -np.tan(np.radians(30))])
