"""No plan has a pose that the gimbal does not reach; what is refused for a limit of the gimbal is refused truly."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import FloatArray, rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.make_plan import make_plan
from panoexec.planning.model import Band, Constraints, GimbalLimits, Plan, Shot, Timing, Turning
from panoexec.planning.reach import check_reachable, reaches_yaw

EPS_DEG = 2e-6
SAMPLED_DEG = 3.0
"""A refusal for less than this cannot be told apart by sampled poses."""


def limited(pitch_deg: tuple[float, float], pan_deg: tuple[float, float], turning: Turning | None) -> GimbalLimits:
    return GimbalLimits(
        pitch_min_deg=pitch_deg[0],
        pitch_max_deg=pitch_deg[1],
        yaw_min_deg=pan_deg[0],
        yaw_max_deg=pan_deg[1],
        yaw_endless=False,
        turning=turning,
    )


@st.composite
def gimbals(draw: st.DrawFn) -> GimbalLimits:
    low = draw(st.floats(-90, 20))
    high = draw(st.one_of(st.just(low), st.floats(low, 90)))
    left = draw(st.floats(-180, 180))
    width = draw(st.one_of(st.just(0.0), st.floats(0, 60), st.floats(60, 359)))
    turning = draw(st.sampled_from([None, None, None, Turning()]))
    return limited((low, high), (left, left + width), turning)


@st.composite
def bands(draw: st.DrawFn) -> Band:
    low = draw(st.floats(-90, 40))
    left, span = draw(st.floats(-180, 180)), draw(st.one_of(st.just(360.0), st.floats(1, 120), st.floats(120, 359)))
    return Band(
        elevation_min_deg=low,
        elevation_max_deg=draw(st.floats(low + 1, min(low + 90, 90))),
        azimuth_min_deg=left,
        azimuth_max_deg=left + span,
    )


def beyond_limits(shots: tuple[Shot, ...], gimbal: GimbalLimits) -> list[Shot]:
    """The poses that the gimbal does not reach, told from its limits alone."""
    out = []
    for shot in shots:
        pans = gimbal.turning is not None or any(
            gimbal.yaw_min_deg - EPS_DEG <= shot.yaw_deg + turn <= gimbal.yaw_max_deg + EPS_DEG
            for turn in (-720.0, -360.0, 0.0, 360.0, 720.0)
        )
        tilts = gimbal.pitch_min_deg - EPS_DEG <= shot.pitch_deg <= gimbal.pitch_max_deg + EPS_DEG
        if not (pans and tilts):
            out.append(shot)
    return out


def seen_from_anywhere(camera: Camera, gimbal: GimbalLimits, band: Band) -> FloatArray:
    """Which directions (n,), sampled over the band, at least one pose within the limits shows."""
    elevation, azimuth = np.meshgrid(
        np.linspace(band.elevation_min_deg, band.elevation_max_deg, 13),
        np.linspace(band.azimuth_min_deg, band.azimuth_max_deg, 37),
    )
    directions = rotation(azimuth.ravel(), elevation.ravel())[..., 0]
    pan = np.linspace(gimbal.yaw_min_deg, gimbal.yaw_max_deg, 73)
    pitch = np.linspace(gimbal.pitch_min_deg, gimbal.pitch_max_deg, 31)
    poses = rotation(*(angle.ravel() for angle in np.meshgrid(pan, pitch)))
    ahead, right, down = np.moveaxis(directions @ poses, -1, 0)
    # a degree to spare, as the poses are samples too
    wide, high = (np.tan(np.arctan(side) + np.radians(1.5)) for side in (camera.half_width, camera.half_height))
    inside = (ahead > 0) & (np.abs(right) <= wide * ahead) & (np.abs(down) <= high * ahead)
    return np.asarray(inside.any(axis=0), dtype=np.float64)


@settings(max_examples=15, derandomize=True, deadline=None)
@given(
    gimbals(),
    bands(),
    st.tuples(st.floats(70, 110), st.floats(50, 90)),
    st.tuples(st.floats(0, 0.4), st.floats(0, 0.4)),
    st.sampled_from(["certified", "certified", "certified", "paper"]),
)
def test_no_plan_has_a_pose_beyond_the_limits_and_refusals_are_true(
    gimbal: GimbalLimits, band: Band, fov: tuple[float, float], overlap: tuple[float, float], method: str
) -> None:
    camera = Camera.from_fov(*fov)
    constraints = Constraints(overlap_h=overlap[0], overlap_v=overlap[1], band=band, gimbal=gimbal)
    try:
        plan = make_plan(camera, constraints, method=method, timing=Timing(), order="fastest")
    except PlanningError as error:
        text = str(error)
        if method == "certified":
            assert "ask for" in text
        missing = re.search(r"([\d.]+)° (?:short|too much)", text)
        if missing is not None and float(missing[1]) < SAMPLED_DEG:
            return
        if "cannot be covered" in text or "do not reach the ends" in text:
            everywhere = limited((gimbal.pitch_min_deg, gimbal.pitch_max_deg), (-180.0, 180.0), None)
            reached = gimbal if "do not reach" in text else everywhere
            assert not seen_from_anywhere(camera, reached, band).all(), text
        return
    assert not beyond_limits(plan.shots, gimbal)


def planned(azimuth_deg: tuple[float, float], gimbal: GimbalLimits, fov: tuple[float, float] = (60.0, 45.0)) -> Plan:
    band = Band(
        elevation_min_deg=-10.0,
        elevation_max_deg=10.0,
        azimuth_min_deg=azimuth_deg[0],
        azimuth_max_deg=azimuth_deg[1],
    )
    constraints = Constraints(overlap_h=0.2, overlap_v=0.2, band=band, gimbal=gimbal)
    return make_plan(Camera.from_fov(*fov), constraints, method="certified", timing=Timing(), order="fastest")


def test_a_sector_beside_the_pan_range_is_seen_from_its_end() -> None:
    plan = planned((21.0, 30.0), limited((-90, 90), (-20, 20), None))
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert [shot.yaw_deg for shot in plan.shots] == pytest.approx([20.0])


def test_a_gimbal_without_pan_axis_sees_what_is_ahead() -> None:
    plan = planned((-25.0, 20.0), limited((-90, 90), (0, 0), None))
    assert [shot.yaw_deg for shot in plan.shots] == pytest.approx([0.0])
    with pytest.raises(PlanningError, match=r"pans from 0 to 0°.* ask for an azimuth sector around 0°.*yaw: auto"):
        planned((20.0, 40.0), limited((-90, 90), (0, 0), None))


def test_with_a_vehicle_that_turns_it_sees_all() -> None:
    plan = planned((20.0, 140.0), limited((-90, 90), (0, 0), Turning()))
    assert plan.certificate is not None
    assert plan.certificate.certified


@pytest.mark.parametrize(
    ("pan", "inside", "outside"),
    [
        ((-20, 20), (20, -20, 340, 0), (21, -21, 180)),
        ((150, 210), (-160, 200, 180), (0, 149, -149)),
        ((7, 7), (7,), (8,)),
    ],
)
def test_a_pan_range_is_the_same_a_turn_further(
    pan: tuple[float, float], inside: tuple[float, ...], outside: tuple[float, ...]
) -> None:
    gimbal = limited((-30, 30), pan, None)
    assert all(reaches_yaw(gimbal, yaw + turn) for yaw in inside for turn in (-360, 0, 360))
    assert not any(reaches_yaw(gimbal, yaw + turn) for yaw in outside for turn in (-360, 0, 360))
    check_reachable([Shot(index=0, row=0, pitch_deg=0.0, yaw_deg=float(inside[0]))], gimbal)
    with pytest.raises(PlanningError, match=r"the gimbal pans from .* smaller azimuth sector"):
        check_reachable([Shot(index=0, row=0, pitch_deg=0.0, yaw_deg=float(outside[0]))], gimbal)
    with pytest.raises(PlanningError, match="the gimbal reaches -30 to 30°"):
        check_reachable([Shot(index=0, row=0, pitch_deg=31.0, yaw_deg=float(inside[0]))], gimbal)
