"""Where the sky begins, as people give it."""

from __future__ import annotations

from pathlib import Path

import pytest

from panoexec.errors import InputFileError
from panoexec.inputs.plan_file import plan_from_data, plan_to_data
from panoexec.inputs.skyline import skyline_from_text, skyline_of, skyline_to_data
from panoexec.optics import Camera
from panoexec.planning.model import Band, Constraints, Plan, Shot
from panoexec.planning.skyline import Skyline

POINTS = [[-170.0, 3.0], [0.0, 12.5], [170.0, 4.0]]


def test_an_elevation_and_points_are_read_and_written() -> None:
    assert skyline_of(5) == Skyline.level(5.0)
    assert skyline_to_data(skyline_of(5)) == 5.0
    assert skyline_to_data(skyline_of([[190, 3], [170, 4], [0, 12.5]])) == POINTS
    assert skyline_to_data(None) is None


def test_a_file_has_an_azimuth_and_an_elevation_in_each_line(tmp_path: Path) -> None:
    file = tmp_path / "sky.csv"
    file.write_text("# surveyed\n190, 3\n\n170 4   # the tower\n0;12.5\n", encoding="utf-8")
    assert skyline_to_data(skyline_from_text(str(file))) == POINTS
    assert skyline_from_text("-2.5") == Skyline.level(-2.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", r"line 1: '1 2 3' is not an azimuth and an elevation"),
        ("0 5\nnorth 5\n", "line 2"),
        ("0 95\n", "elevation 95: give degrees from -90 to 90"),
        ("0 5\n360 6\n", "azimuth 0 twice"),
        ("", "has 0 points"),
        ("0 nan\n", "elevation nan"),
        ("1e9 1\n", "azimuth 1e"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "sky.txt"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError, match=message):
        skyline_from_text(str(file))


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(InputFileError, match="cannot be read"):
        skyline_from_text("no-such-file.txt")
    with pytest.raises(ValueError, match="elevation 91"):
        skyline_from_text("91")


@pytest.mark.parametrize("value", [4.0, POINTS])
def test_a_plan_file_keeps_it(value: float | list[list[float]]) -> None:
    constraints = Constraints(
        overlap_h=0.1,
        overlap_v=0.1,
        band=Band(elevation_min_deg=-90, elevation_max_deg=0),
        textured_below=skyline_of(value),
    )
    shots = (
        Shot(index=0, row=0, pitch_deg=-40.0, yaw_deg=0.0),
        Shot(index=1, row=1, pitch_deg=50.0, yaw_deg=0.0, geometry_only=True),
    )
    data = plan_to_data(Plan(method="certified", camera=Camera.from_fov(60, 45), constraints=constraints, shots=shots))
    assert data["constraints"]["textured_below"] == value
    assert [shot.get("geometry_only") for shot in data["shots"]] == [None, True]
    again = plan_from_data(data, source="plan.json")
    assert again.constraints is not None
    assert again.constraints.textured_below == constraints.textured_below
    data["constraints"]["textured_below"] = [[0, 5], [0, 6]]
    with pytest.raises(InputFileError, match="twice"):
        plan_from_data(data, source="plan.json")
