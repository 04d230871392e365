import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from panoexec.angles import direction, rotation
from panoexec.optics import Camera
from panoexec.planning.baselines.ring import cap_radius_deg, ring
from panoexec.planning.geometry.footprint import inside_margin

fov = st.floats(5, 120)
cameras = st.builds(Camera.from_fov, fov, fov)


@given(cameras, st.floats(-90, 90), st.floats(0.1, 90))
def test_image_covers_its_ring_at_every_azimuth(camera: Camera, pitch: float, reach: float) -> None:
    low, high = (float(x) for x in ring(camera, pitch, reach))
    assume(high > low)
    azimuth, share = np.meshgrid(np.linspace(-reach, reach, 41), np.linspace(0, 1, 21))
    inside = inside_margin(camera, rotation(0.0, pitch), direction(low + share * (high - low), azimuth))
    assert inside.min() > -1e-9


@given(cameras, st.floats(-80, 80), st.floats(0.1, 60))
def test_a_ring_ends_where_some_azimuth_is_no_longer_covered(camera: Camera, pitch: float, reach: float) -> None:
    low, high = (float(x) for x in ring(camera, pitch, reach))
    assume(high > low)
    azimuth = np.linspace(-reach, reach, 401)
    for beyond in (high + 0.01, low - 0.01):
        if abs(beyond) < 90:
            assert inside_margin(camera, rotation(0.0, pitch), direction(beyond, azimuth)).min() < 0


def test_rings_of_known_images() -> None:
    camera = Camera.from_fov(60, 40)
    assert np.array(ring(camera, 0.0, 0.0)) == pytest.approx([-20, 20])
    # at the horizon the upper edge sinks with the azimuth: tan e = tan 20° · cos δ
    dip = np.degrees(np.arctan(np.tan(np.radians(20)) * np.cos(np.radians(30))))
    assert ring(camera, 0.0, 29.99999)[1] == pytest.approx(dip, abs=1e-4)
    assert ring(camera, -90.0, 45.0)[0] == -90.0
    low, high = ring(camera, 0.0, 31.0)
    assert low > high  # wider than the image
    low, high = ring(camera, -90.0, 120.0)
    assert low > high  # nothing is claimed beyond 90°


def test_a_cap_covers_a_circle() -> None:
    camera = Camera.from_fov(40, 60)
    assert cap_radius_deg(camera) == pytest.approx(20)
    rim = direction(-90.0 + 19.99, np.arange(0.0, 360.0, 5.0))
    assert inside_margin(camera, rotation(17.0, -90.0), rim).min() > 0
