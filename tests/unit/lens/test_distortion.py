from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.lens.distortion import Distortion


def lenses() -> st.SearchStrategy[Distortion]:
    """Distortions as those of lenses from fish-eye-like to telephoto, images up to 90° wide."""
    return st.builds(
        Distortion,
        k1=st.floats(-0.15, 0.15),
        k2=st.floats(-0.03, 0.03),
        k3=st.floats(-0.01, 0.01),
        p1=st.floats(-0.004, 0.004),
        p2=st.floats(-0.004, 0.004),
    )


def test_it_is_the_model_of_opencv() -> None:
    y, z = 0.3, -0.2
    k1, k2, k3, p1, p2 = -0.1, 0.05, -0.02, 0.003, -0.002
    r2 = y * y + z * z
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected = (
        y * radial + 2 * p1 * y * z + p2 * (r2 + 2 * y * y),
        z * radial + p1 * (r2 + 2 * z * z) + 2 * p2 * y * z,
    )
    assert Distortion(k1, k2, k3, p1, p2).apply([y, z]) == pytest.approx(expected, abs=1e-15)


@given(lens=lenses(), radius=st.floats(0.0, 1.0), angle=st.floats(0, 2 * math.pi))
def test_what_is_undone_was_applied(lens: Distortion, radius: float, angle: float) -> None:
    if lens.least_slope(1.05) <= 0.2:
        return
    ideal = radius * np.array([math.cos(angle), math.sin(angle)])
    assert lens.undo(lens.apply(ideal)) == pytest.approx(ideal, abs=1e-9)


@given(lens=lenses(), y=st.floats(-1, 1), z=st.floats(-1, 1))
def test_the_jacobian_is_the_derivative_and_its_bounds_hold(lens: Distortion, y: float, z: float) -> None:
    x, step = np.array([y, z]), 1e-5
    numeric = np.stack([(lens.apply(x + d) - lens.apply(x - d)) / (2 * step) for d in np.eye(2) * step], axis=1)
    exact = lens.jacobian(x)
    assert exact == pytest.approx(numeric, abs=1e-8)
    radius = float(np.hypot(y, z)) * 1.001
    assert np.linalg.eigvalsh(exact).min() >= lens.least_slope(radius)
    u = np.array([0.6, 0.8])
    bend = (lens.apply(x + 1e-3 * u) - 2 * lens.apply(x) + lens.apply(x - 1e-3 * u)) / 1e-6
    assert float(np.linalg.norm(bend)) <= lens.most_curved(radius + 2e-3) + 1e-6


@given(lens=lenses(), y=st.floats(-1, 1), z=st.floats(-1, 1))
def test_a_turned_camera_has_the_turned_lens(lens: Distortion, y: float, z: float) -> None:
    distorted = lens.apply([y, z])
    turned = lens.rotated().apply([-z, y])
    assert turned == pytest.approx([-distorted[1], distorted[0]], abs=1e-12)


def test_a_lens_that_turns_back_within_the_image_is_refused() -> None:
    with pytest.raises(ValueError, match="turns back within the image"):
        Distortion(k1=-0.9).radius_for(0.7)
    assert Distortion(k1=-0.1).radius_for(0.7) >= 0.7


def test_a_point_beyond_the_lens_is_not_undone() -> None:
    assert np.isnan(Distortion(k1=-0.3).undo([[5.0, 5.0]])).all()
