from __future__ import annotations

import numpy as np
import pytest

from panoexec.angles import FloatArray, angle_between, rotation
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.stitching.adjustment import Lens, Points, Prior, adjust, separation_deg, spread_points, tied_group

LENS = Lens(width_px=800, height_px=601, focal_length_px=693.6)
ROWS = [(-90.0, 1), (-60.0, 5), (-25.0, 8)]
YAW = np.array([360 * k / n for _, n in ROWS for k in range(n)])
PITCH = np.array([p for p, n in ROWS for _ in range(n)])


def project(lens: Lens, rotations: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stored pixels (n, m, 2) of directions (m, 3) in each image, and whether they are in it; the lens forwards."""
    rays = np.einsum("nji,mj->nmi", rotations, directions)
    with np.errstate(divide="ignore", invalid="ignore"):
        ideal = lens.focal_length_px * rays[..., 1:] / rays[..., :1]
    unit = min(lens.width_px, lens.height_px) / 2
    radius2 = np.sum(ideal**2, axis=-1, keepdims=True) / unit**2
    pixels = ideal * (lens.distortion * radius2 + 1 - lens.distortion)
    pixels += np.array([lens.width_px / 2, lens.height_px / 2]) - 0.5
    inside = (rays[..., 0] > 0) & (pixels >= 0).all(-1) & (pixels <= [lens.width_px - 1, lens.height_px - 1]).all(-1)
    return pixels, inside


def observe(lens: Lens, truth: FloatArray, rng: np.random.Generator, noise_px: float = 0.3) -> Points:
    """Control points of random directions below the horizon."""
    directions = rng.normal(size=(1500, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    pixels, inside = project(lens, truth, directions)
    images, places = [], []
    for a in range(len(truth)):
        for b in range(a + 1, len(truth)):
            for m in np.flatnonzero(inside[a] & inside[b])[:12]:
                images.append((a, b))
                places.append(np.concatenate([pixels[a, m], pixels[b, m]]) + rng.normal(size=4) * noise_px)
    return Points(images=np.array(images, dtype=np.intp), pixels=np.array(places))


def errors(rng: np.random.Generator, count: int) -> FloatArray:
    """The paper's pointing errors, axis by axis."""
    return rng.normal(size=(count, 3)) * [0.667, 0.017, 0.017]


def truth_of(rng: np.random.Generator) -> FloatArray:
    e = errors(rng, len(YAW))
    return rotation(YAW + e[:, 0], PITCH + e[:, 1], e[:, 2])


def misalignment_deg(found: FloatArray, truth: FloatArray) -> FloatArray:
    """Angles of the rotations left over, after the best rotation of the whole."""
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth, found))
    whole = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    left = np.swapaxes(truth, -1, -2) @ (whole @ found)
    return np.asarray(np.degrees(np.arccos(np.clip((np.trace(left, axis1=1, axis2=2) - 1) / 2, -1, 1))))


@pytest.mark.parametrize("refine_lens", [True, False])
def test_images_are_aligned_to_a_fraction_of_a_pixel(refine_lens: bool) -> None:
    rng = np.random.default_rng(1)
    truth = truth_of(rng)
    points = observe(LENS, truth, rng)
    found = adjust(points, rotation(YAW, PITCH), LENS, refine_lens=refine_lens)
    pixel = np.degrees(1 / LENS.focal_length_px)
    assert misalignment_deg(found.rotations, truth).max() < 0.5 * pixel
    assert found.rms_px < 0.6
    assert found.kept.mean() > 0.99
    # the panorama as a whole stays where the measured attitudes put it
    assert angle_between(found.rotations[:, :, 0], rotation(YAW, PITCH)[:, :, 0]).mean() < 1.0


def test_the_pose_at_the_nadir_is_aligned_like_any_other() -> None:
    rng = np.random.default_rng(2)
    truth = truth_of(rng)
    truth[0] = rotation(25.0, -89.6, 0.4)
    found = adjust(observe(LENS, truth, rng), rotation(YAW, PITCH), LENS, prior=Prior(yaw_deg=30.0))
    assert misalignment_deg(found.rotations, truth)[0] < 0.06


def test_a_poor_lens_is_found_out() -> None:
    rng = np.random.default_rng(3)
    truth = truth_of(rng)
    real = Lens(width_px=800, height_px=601, focal_length_px=693.6 * 1.012, distortion=-0.015)
    points = observe(real, truth, rng)
    found = adjust(points, rotation(YAW, PITCH), LENS)
    assert found.lens.focal_length_px == pytest.approx(real.focal_length_px, rel=1e-3)
    assert found.lens.distortion == pytest.approx(-0.015, abs=1e-3)
    assert found.rms_px < 0.6
    fixed = adjust(points, rotation(YAW, PITCH), LENS, refine_lens=False)
    assert fixed.rms_px > 3 * found.rms_px


def test_wrong_points_are_left_out() -> None:
    rng = np.random.default_rng(4)
    truth = truth_of(rng)
    points = observe(LENS, truth, rng)
    wrong = rng.random(len(points)) < 0.15
    points.pixels[wrong, 2:] += rng.normal(size=(wrong.sum(), 2)) * 40 + 15
    found = adjust(points, rotation(YAW, PITCH), LENS)
    assert misalignment_deg(found.rotations, truth).max() < 0.08
    assert found.kept[~wrong].mean() > 0.98
    assert found.kept[wrong].mean() < 0.1


def test_an_image_without_points_keeps_its_measured_attitude() -> None:
    rng = np.random.default_rng(5)
    truth = truth_of(rng)
    points = observe(LENS, truth, rng)
    points = points.only((points.images != 7).all(axis=1))
    measured = rotation(YAW, PITCH)
    found = adjust(points, measured, LENS)
    np.testing.assert_allclose(found.rotations[7], measured[7], atol=1e-9)
    assert tied_group(points, len(YAW)) == frozenset(range(len(YAW))) - {7}


def test_no_points_at_all_change_nothing() -> None:
    none = Points(images=np.empty((0, 2), dtype=np.intp), pixels=np.empty((0, 4)))
    found = adjust(none, rotation(YAW, PITCH), LENS)
    np.testing.assert_allclose(found.rotations, rotation(YAW, PITCH), atol=1e-12)
    assert found.lens == LENS
    assert np.isnan(found.rms_px)
    assert tied_group(none, len(YAW)) == frozenset()


def test_nothing_runs_away_even_if_every_point_is_wrong() -> None:
    rng = np.random.default_rng(6)
    points = observe(LENS, truth_of(rng), rng)
    points.pixels[:] = rng.random(points.pixels.shape) * 600
    found = adjust(points, rotation(YAW, PITCH), LENS)
    e = pose_error(PITCH, YAW, found.rotations)
    assert e.boresight_deg.max() < 5
    assert found.lens.focal_length_px == pytest.approx(LENS.focal_length_px, rel=0.1)


def test_rays_undo_the_lens() -> None:
    lens = Lens(width_px=800, height_px=601, focal_length_px=700.0, distortion=0.03)
    directions = np.array([[1, 0.3, 0.2], [1, -0.5, 0.4], [1, 0, 0]])
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    pixels, _ = project(lens, np.eye(3)[None], directions)
    np.testing.assert_allclose(lens.rays(pixels[0, :, 0], pixels[0, :, 1]), directions, atol=1e-9)


def test_separation_is_in_degrees() -> None:
    points = Points(images=np.array([[0, 1]]), pixels=np.array([[399.5, 300.0, 399.5, 300.0]]))
    assert separation_deg(points, rotation([0.0, 3.0], [0.0, 0.0]), LENS)[0] == pytest.approx(3.0)


def test_points_are_thinned_to_a_spread_few_per_pair() -> None:
    rng = np.random.default_rng(7)
    corners = np.array([[0, 0], [700, 0], [0, 500], [700, 500]], dtype=float)
    crowd = np.concatenate([rng.normal(size=(60, 2)) * 3 + 300, corners])
    points = Points(
        images=np.array([[0, 1]] * 64 + [[2, 1]] * 3, dtype=np.intp),
        pixels=np.concatenate([np.hstack([crowd, crowd]), np.zeros((3, 4))]),
    )
    thin = spread_points(points, 8)
    assert np.bincount(thin.images[:, 0]).tolist() == [8, 0, 3]
    for corner in corners:
        assert (thin.pixels[:, :2] == corner).all(axis=1).any()


def test_groups_need_three_points_a_pair() -> None:
    images = np.array([[0, 1]] * 3 + [[1, 2]] * 2 + [[3, 4]] * 3 + [[5, 4]] * 3, dtype=np.intp)
    points = Points(images=images, pixels=np.zeros((len(images), 4)))
    assert tied_group(points, 7) == {3, 4, 5}
    assert tied_group(points, 7, least=2) in ({0, 1, 2}, {3, 4, 5})
