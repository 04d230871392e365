import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from panoexec.angles import rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.raycast import raycast_overlap
from panoexec.planning.geometry.overlap import (
    clip_footprint,
    half_planes,
    pairwise_overlap,
    polygon_area,
    subtract,
    union_area,
    union_overlap,
)

GRID = (56, 44)
fov = st.floats(2, 150)
cameras = st.builds(Camera.from_fov, fov, fov)
angle = st.floats(-180, 180)


def random_rotation(rng: np.random.Generator, spread_deg: float = 180.0) -> NDArray[np.float64]:
    yaw, pitch, roll = rng.uniform(-spread_deg, spread_deg, 3)
    return rotation(yaw, pitch, roll)


def random_camera(rng: np.random.Generator) -> Camera:
    return Camera.from_fov(*rng.uniform(3, 150, 2))


def test_agrees_with_ray_casting_within_the_pixel_quantisation() -> None:
    """10 000 random pairs of poses, each with two random cameras: never further off than a grid can be."""
    rng = np.random.default_rng(20240611)
    bound = 1 / GRID[0] + 1 / GRID[1]
    errors, overlaps = [], []
    for _ in range(10_000):
        camera_a, camera_b = random_camera(rng), random_camera(rng)
        a = random_rotation(rng)
        # near enough to overlap more often than not
        b = a @ random_rotation(rng, 0.6 * max(camera_a.hfov_deg, camera_b.hfov_deg))
        exact = float(pairwise_overlap(camera_a, a, b, camera_b))
        errors.append(exact - raycast_overlap(camera_a, a, b, grid=GRID, camera_b=camera_b))
        overlaps.append(exact)
    assert np.abs(errors).max() < bound
    # the grid has no bias, so neither may the difference have one
    assert abs(np.mean(errors)) < 2e-4
    partial = np.mean((np.array(overlaps) > 0.01) & (np.array(overlaps) < 0.99))
    assert partial > 0.4  # the comparison is about something


def test_converges_to_ray_casting_as_pixels_become_many() -> None:
    camera = Camera.from_fov(59.94, 46.86)
    a, b = rotation(0.0, -39.0), rotation(53.0, -20.0)
    exact = pairwise_overlap(camera, a, b)
    assert raycast_overlap(camera, a, b, grid=(3000, 3000)) == pytest.approx(exact, abs=2e-4)


@pytest.mark.parametrize(
    ("camera", "share"),
    [(Camera.from_fov(90, 90), 0.5), (Camera.from_fov(60, 40), 0.25), (Camera.from_fov(20, 30), 0.9)],
)
def test_tilt_of_a_pinhole_has_a_closed_form(camera: Camera, share: float) -> None:
    """A camera tilted by t sees of the other's plane what is above tan(t - v/2): a trapezium, clipped in width."""
    tilt = camera.vfov_deg * (1 - share)
    up = np.tan(np.radians(tilt - camera.vfov_deg / 2))
    # in A's plane, B's side edges are |y| ≤ w·(cos t + z'·sin t) with z' up
    z = np.linspace(max(up, -camera.half_height), camera.half_height, 200_001)
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    width = 2 * np.minimum(camera.half_width, camera.half_width * (c + z * s))
    expected = np.trapezoid(width, z) / (4 * camera.half_width * camera.half_height)
    assert pairwise_overlap(camera, np.eye(3), rotation(0.0, tilt)) == pytest.approx(expected, abs=1e-9)


def test_the_papers_tilt_steps() -> None:
    """Facts worked out independently: 15 % at tilts of 40.2°, 14.0° and 21.4° for the paper's three cameras."""
    for hfov, vfov, step in ((59.9412, 46.8574, 40.2), (21.7616, 16.4384, 14.0), (37.1153, 25.1269, 21.4)):
        camera = Camera.from_fov(hfov, vfov)
        less, more = pairwise_overlap(camera, np.eye(3), rotation(0.0, np.array([step - 0.06, step + 0.06])))
        assert less > 0.15 > more


@given(cameras, angle, angle, angle)
def test_an_image_overlaps_itself_wholly_and_its_opposite_not_at_all(
    camera: Camera, yaw: float, pitch: float, roll: float
) -> None:
    pose = rotation(yaw, pitch, roll)
    assert pairwise_overlap(camera, pose, pose) == pytest.approx(1.0, abs=1e-9)
    backwards = pose @ np.diag([-1.0, -1.0, 1.0])
    assert pairwise_overlap(camera, pose, backwards) == 0.0


@given(cameras, cameras, angle, angle, angle, angle, angle)
def test_overlap_does_not_depend_on_the_world_and_is_a_fraction(
    camera: Camera, other: Camera, yaw: float, pitch: float, roll: float, turn: float, tilt: float
) -> None:
    a, b = rotation(yaw, pitch, roll), rotation(turn, tilt)
    overlap = float(pairwise_overlap(camera, a, b, other))
    assert 0.0 <= overlap <= 1.0
    moved = rotation(tilt, turn, yaw)
    assert pairwise_overlap(camera, moved @ a, moved @ b, other) == pytest.approx(overlap, abs=1e-7)


@given(cameras, st.floats(0, 179), st.floats(-90, 90))
def test_neighbours_in_a_row_see_as_much_of_each_other(camera: Camera, pan: float, pitch: float) -> None:
    a, b = rotation(0.0, pitch), rotation(pan, pitch)
    assert pairwise_overlap(camera, a, b) == pytest.approx(float(pairwise_overlap(camera, b, a)), abs=1e-9)


def test_shapes_broadcast() -> None:
    camera = Camera.from_fov(40, 30)
    rows = rotation(np.zeros(3), np.array([0.0, -20.0, -40.0]))
    table = pairwise_overlap(camera, rows[:, None], rows[None, :])
    assert table.shape == (3, 3)
    assert np.diagonal(table) == pytest.approx(1.0)
    assert pairwise_overlap(camera, rows[0], rows[1]).shape == ()
    assert pairwise_overlap(camera, np.empty((0, 3, 3)), np.empty((0, 3, 3))).shape == (0,)


def test_many_at_once_are_as_one_at_a_time() -> None:
    rng = np.random.default_rng(5)
    camera = Camera.from_fov(70, 50)
    a = np.stack([random_rotation(rng) for _ in range(300)])
    b = np.stack([random_rotation(rng) for _ in range(300)])
    together = pairwise_overlap(camera, a, b)
    alone = [float(pairwise_overlap(camera, a[i], b[i])) for i in range(300)]
    assert together == pytest.approx(alone, abs=1e-12)
    assert (together > 0).sum() > 30


def test_a_clipped_footprint_has_its_corners_in_both_images() -> None:
    rng = np.random.default_rng(6)
    camera = Camera.from_fov(70, 50)
    for _ in range(100):
        a, b = random_rotation(rng), random_rotation(rng)
        (polygon,) = clip_footprint(camera, a, b)
        if np.isnan(polygon).any():
            assert pairwise_overlap(camera, a, b) == 0
            continue
        assert np.abs(polygon[:, 0]).max() <= camera.half_width + 1e-9
        assert np.abs(polygon[:, 1]).max() <= camera.half_height + 1e-9
        rays = np.concatenate([np.ones((len(polygon), 1)), polygon], axis=1)
        assert (rays @ half_planes(a, b, camera).T).min() > -1e-9


class TestUnion:
    def test_agrees_with_counting_points(self) -> None:
        rng = np.random.default_rng(7)
        camera = Camera.from_fov(60, 45)
        partners = np.stack([[random_rotation(rng, 45) for _ in range(4)] for _ in range(40)])
        exact = union_overlap(camera, np.broadcast_to(np.eye(3), (40, 3, 3)), partners)
        y, z = (rng.uniform(-1, 1, (2, 40_000)).T * [camera.half_width, camera.half_height]).T
        rays = np.stack([np.ones_like(y), y, z], axis=1)
        for own, planes in zip(exact, half_planes(np.eye(3), partners, camera), strict=True):
            seen = np.zeros(len(rays), dtype=bool)
            for image in planes:
                seen |= (rays @ image.T >= 0).all(axis=1)
            assert own == pytest.approx(seen.mean(), abs=5 * 0.5 / np.sqrt(len(rays)))

    @given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=5), st.floats(20, 100))
    def test_lies_between_the_largest_and_the_sum(self, poses: list[tuple[float, float]], width: float) -> None:
        camera = Camera.from_fov(width, 0.8 * width)
        partners = np.stack([rotation(yaw, pitch) for yaw, pitch in poses])
        single = pairwise_overlap(camera, np.eye(3), partners)
        (union,) = union_overlap(camera, np.eye(3)[None], partners[None])
        assert single.max() - 1e-9 <= union <= min(1.0, single.sum()) + 1e-9
        for order in itertools.islice(itertools.permutations(range(len(poses))), 4):
            (again,) = union_overlap(camera, np.eye(3)[None], partners[list(order)][None])
            assert again == pytest.approx(union, abs=1e-9)

    def test_padding_does_not_count(self) -> None:
        camera = Camera.from_fov(60, 45)
        partners = np.stack([rotation(0.0, 30.0), rotation(0.0, -5.0)])[None]
        (with_all,) = union_overlap(camera, np.eye(3)[None], partners)
        (padded,) = union_overlap(camera, np.eye(3)[None], partners, present=[[True, False]])
        assert padded == pytest.approx(float(pairwise_overlap(camera, np.eye(3), rotation(0.0, 30.0))))
        assert with_all > padded + 0.2

    def test_areas_of_squares(self) -> None:
        square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
        shifted = [[y + 0.5, z + 0.5] for y, z in square]
        assert union_area([square]) == pytest.approx(1.0)
        assert union_area([square, shifted]) == pytest.approx(1.75)
        assert union_area([square, shifted[::-1], square]) == pytest.approx(1.75)
        assert union_area([square, [[5.0, 5.0], [6.0, 5.0], [5.0, 6.0]]]) == pytest.approx(1.5)
        assert union_area([square, [[0.2, 0.2], [0.4, 0.2], [0.3, 0.4]]]) == pytest.approx(1.0)
        assert union_area([]) == 0.0


def test_difference_and_subtracted_part_add_up_to_the_whole() -> None:
    rng = np.random.default_rng(8)
    camera = Camera.from_fov(60, 45)
    whole = 4 * camera.half_width * camera.half_height
    for _ in range(50):
        planes = half_planes(np.eye(3), random_rotation(rng, 40), camera)
        polygon = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        polygon *= [camera.half_width, camera.half_height]
        pieces, owners = subtract(polygon[None], planes[None, None])
        assert (owners == 0).all()
        # no piece has a point inside what was taken out
        middles = np.nanmean(pieces, axis=1)
        rays = np.concatenate([np.ones((len(middles), 1)), middles], axis=1)
        assert not (rays @ planes.T > 1e-9).all(axis=1).any()
        seen = clip_footprint(camera, np.eye(3), np.eye(3))  # the whole image
        assert polygon_area(seen)[0] == pytest.approx(whole)
        assert polygon_area(pieces).sum() <= whole + 1e-12
