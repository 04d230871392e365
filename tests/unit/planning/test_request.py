from dataclasses import replace

import pytest

from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Tolerance
from panoexec.planning.request import check_request

CAMERA = Camera.from_fov(60, 45)
BAND = Band(elevation_min_deg=-90, elevation_max_deg=30)
FINE = Constraints(overlap_h=0.15, overlap_v=0.15, band=BAND)


def problem(request: Constraints) -> str:
    """What is wrong with a request; "" if nothing is."""
    try:
        check_request(CAMERA, request)
    except PlanningError as error:
        return str(error)
    return ""


def test_reasonable_requests_pass() -> None:
    mask = AngleBox(elevation_min_deg=-30, elevation_max_deg=0, azimuth_min_deg=170, azimuth_max_deg=190)
    assert problem(FINE) == ""
    assert problem(replace(FINE, overlap_h=0.0, overlap_v=0.99)) == ""
    assert problem(replace(FINE, band=replace(BAND, azimuth_min_deg=170, azimuth_max_deg=190))) == ""
    assert problem(replace(FINE, masks=(mask,), gimbal=GimbalLimits())) == ""


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"overlap_h": 1.2}, "horizontal overlap 1.2"),
        ({"overlap_v": 15}, r"vertical overlap 15 .*15 % is 0\.15"),
        ({"overlap_v": float("nan")}, "vertical overlap nan"),
        ({"overlap_h": -0.01}, "horizontal overlap -0.01"),
        ({"band": replace(BAND, elevation_min_deg=30, elevation_max_deg=-90)}, "reversed"),
        ({"band": replace(BAND, elevation_min_deg=30, elevation_max_deg=30)}, "empty"),
        ({"band": replace(BAND, elevation_max_deg=91)}, "out of range"),
        ({"band": replace(BAND, elevation_max_deg=float("nan"))}, "out of range"),
        ({"band": replace(BAND, azimuth_min_deg=10, azimuth_max_deg=10)}, "is empty"),
        ({"band": replace(BAND, azimuth_min_deg=10, azimuth_max_deg=-350)}, "is empty"),
        ({"band": replace(BAND, azimuth_min_deg=0, azimuth_max_deg=361)}, "at most 360"),
        ({"band": replace(BAND, azimuth_max_deg=float("inf"))}, "azimuth is -180 to inf"),
        ({"tolerance": Tolerance(pitch_deg=-0.1, roll_deg=0, yaw_deg=0)}, "pitch tolerance -0.1"),
        ({"tolerance": Tolerance(pitch_deg=0, roll_deg=0, yaw_deg=90)}, "yaw tolerance 90"),
        ({"tolerance": Tolerance(pitch_deg=0, roll_deg=float("nan"), yaw_deg=0)}, "roll tolerance nan"),
        ({"gimbal": GimbalLimits(pitch_min_deg=10, pitch_max_deg=-10)}, "pitch limits 10 to -10"),
        ({"gimbal": GimbalLimits(yaw_min_deg=10, yaw_max_deg=-10)}, "pan limits 10 to -10"),
        (
            {"masks": (AngleBox(elevation_min_deg=0, elevation_max_deg=0, azimuth_min_deg=0, azimuth_max_deg=1),)},
            "mask elevation 0 to 0",
        ),
        (
            {"masks": (AngleBox(elevation_min_deg=0, elevation_max_deg=1, azimuth_min_deg=0, azimuth_max_deg=0),)},
            "mask azimuth",
        ),
    ],
)
def test_invalid_requests_are_named(changes: dict[str, object], says: str) -> None:
    with pytest.raises(PlanningError, match=says) as raised:
        check_request(CAMERA, replace(FINE, **changes))  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)
    assert raised.value.exit_code == 2


@pytest.mark.parametrize(("hfov", "vfov"), [(179.5, 40), (40, 179.9), (0.01, 0.01)])
def test_fields_of_view_beyond_the_pinhole_model_are_rejected(hfov: float, vfov: float) -> None:
    with pytest.raises(PlanningError, match="field of view"):
        check_request(Camera.from_fov(hfov, vfov), FINE)
