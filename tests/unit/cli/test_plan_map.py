from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.angles import direction, rotation
from panoexec.cli.plan_map import on_map, plan_figure, plot_plan
from panoexec.errors import DependencyError, UsageError
from panoexec.optics import Camera
from panoexec.planning.geometry.footprint import outline
from panoexec.planning.model import AngleBox, Band, Certificate, Constraints, Hole, Plan, Shot, Tolerance

CAMERA = Camera.from_fov(60.0, 47.0, name="test camera")


def plan(
    rows: dict[float, int],
    *,
    band: Band | None = None,
    masks: tuple[AngleBox, ...] = (),
    certificate: Certificate | None = None,
) -> Plan:
    poses = [(row, pitch, 360 * k / n - 180) for row, (pitch, n) in enumerate(rows.items()) for k in range(n)]
    return Plan(
        method="foreign",
        camera=CAMERA,
        constraints=Constraints(
            overlap_h=0.15,
            overlap_v=0.2,
            band=band or Band(elevation_min_deg=-90, elevation_max_deg=5),
            tolerance=Tolerance(pitch_deg=0.017, roll_deg=0.017, yaw_deg=0.667),
            masks=masks,
        ),
        shots=tuple(Shot(index=i, row=r, pitch_deg=p, yaw_deg=y) for i, (r, p, y) in enumerate(poses)),
        certificate=certificate,
    )


FULL = plan({-90.0: 1, -50.0: 7, -10.0: 8})


def test_writes_png_and_svg_by_suffix(tmp_path: Path) -> None:
    plot_plan(FULL, tmp_path / "a.png", dots_per_inch=50)
    with PIL.Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (640, 360)
    plot_plan(FULL, tmp_path / "a.SVG", show_route=True)
    root = ET.parse(tmp_path / "a.SVG").getroot()
    words = "".join(root.itertext())
    assert "test camera: 16 images in 3 rows" in words
    assert "shooting order" in words
    assert "±0.667° yaw" in words
    assert "−50.0°  ×7" in words
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.SVG", "a.png"]


def test_the_same_plan_gives_the_same_file(tmp_path: Path) -> None:
    plot_plan(FULL, tmp_path / "a.svg")
    plot_plan(FULL, tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


@pytest.mark.parametrize(("name", "text"), [("a.jpg", "suffix '.jpg'"), ("plot", "no suffix"), ("a.png.bak", ".bak")])
def test_other_suffixes_are_refused_and_nothing_is_written(tmp_path: Path, name: str, text: str) -> None:
    with pytest.raises(UsageError, match=r"written as \.png or \.svg") as caught:
        plot_plan(FULL, tmp_path / name)
    assert text in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_an_unwritable_folder_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be written"):
        plot_plan(FULL, tmp_path / "gone" / "a.png")


def test_without_matplotlib_the_message_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(DependencyError, match=r"pip install '\.\[report\]'"):
        plot_plan(FULL, tmp_path / "a.png")


def shaded(a_plan: Plan) -> np.ndarray:
    """The shading as drawn, (720, 1440, 3), row 0 at the zenith."""
    image = plan_figure(a_plan).axes[0].images[0].get_array()
    assert image is not None
    return np.asarray(image)


def test_gaps_in_the_band_are_marked_and_only_there() -> None:
    gap = np.array([0xF4, 0x51, 0x1E]) / 255
    full = shaded(FULL)
    assert not np.isclose(full, gap).all(axis=2).any()
    # without the nadir image nothing below about -74° is seen
    holed = np.isclose(shaded(plan({-50.0: 7, -10.0: 8})), gap).all(axis=2)
    assert holed[-20:].all()
    assert not holed[:600].any()
    # what is masked needs no coverage
    mask = AngleBox(elevation_min_deg=-90, elevation_max_deg=-70, azimuth_min_deg=-180, azimuth_max_deg=180)
    assert not np.isclose(shaded(plan({-50.0: 7, -10.0: 8}, masks=(mask,))), gap).all(axis=2).any()


def test_more_images_are_darker_and_outside_the_band_is_dimmed() -> None:
    sector = Band(elevation_min_deg=-30, elevation_max_deg=0, azimuth_min_deg=-60, azimuth_max_deg=60)
    picture = shaded(plan({-10.0: 8}, band=sector))
    row = picture[400]  # elevation -10°
    one, two = row[720], row[720 + int(22.5 * 4)]
    assert two.sum() < one.sum()
    outside = row[45 * 4]  # another image's middle
    assert not np.allclose(outside, one)


def certificate(**changes: object) -> Certificate:
    values: dict[str, object] = {
        "certified": False,
        "images": 14,
        "min_overlap_h": 0.123,
        "min_overlap_v": 0.2,
        "worst_overlap_h": 0.1,
        "worst_overlap_v": 0.1,
        "uncovered_fraction": 0.0002,
        "connected": True,
        "two_edge_connected": False,
        "holes": (Hole(elevation_deg=-74, azimuth_deg=175, size_deg=1.2),),
        "weakest_h": (1, 5),
        "weakest_v": 3,
        "bridges": ((0, 1),),
    }
    return Certificate(**{**values, **changes})  # type: ignore[arg-type]


def legend(a_plan: Plan) -> list[str]:
    found = plan_figure(a_plan).axes[0].get_legend()
    assert found is not None
    return [text.get_text() for text in found.get_texts()]


def test_what_the_certificate_found_is_in_the_picture() -> None:
    labels = legend(plan({-90.0: 1, -50.0: 7, -10.0: 8}, certificate=certificate()))
    assert "least overlap in a row: 12.3%" in labels
    assert "least overlap of rows: 20.0%" in labels
    assert "single connecting pair (bridge)" in labels
    assert "1 hole, up to 1.2°" in labels
    clean = certificate(certified=True, holes=(), bridges=(), weakest_h=None, weakest_v=None, uncovered_fraction=0.0)
    certified = plan({-90.0: 1, -50.0: 7, -10.0: 8}, certificate=clean)
    assert legend(certified) == ["requested band"]
    assert ", certified" in plan_figure(certified).axes[0].get_title(loc="left")
    assert "NOT certified" in plan_figure(plan({-50.0: 7}, certificate=certificate())).axes[0].get_title(loc="left")


def test_a_band_and_a_mask_across_the_back_and_a_single_image() -> None:
    sector = Band(elevation_min_deg=-30, elevation_max_deg=0, azimuth_min_deg=150, azimuth_max_deg=210)
    mask = AngleBox(elevation_min_deg=-20, elevation_max_deg=-10, azimuth_min_deg=170, azimuth_max_deg=190)
    labels = legend(plan({-15.0: 1}, band=sector, masks=(mask,)))
    assert labels == ["requested band", "masked"]


@given(yaw=st.floats(-180, 180), pitch=st.floats(-90, 90))
def test_outlines_never_run_across_the_map(yaw: float, pitch: float) -> None:
    points = outline(CAMERA, rotation(yaw, pitch), 96)
    azimuth, elevation = on_map(np.concatenate([points, points[:1]]))
    steps = np.abs(np.diff(azimuth))
    assert np.nanmax(steps) <= 180
    # a cut happens on the border alone, and both of its ends are there, at one height
    for gap in np.flatnonzero(np.isnan(azimuth)):
        assert abs(azimuth[gap - 1]) == abs(azimuth[gap + 1]) == 180
        assert azimuth[gap - 1] == -azimuth[gap + 1]
        assert elevation[gap - 1] == elevation[gap + 1]


def test_a_path_is_cut_where_it_crosses_the_back() -> None:
    azimuth, elevation = on_map(direction([0.0, 10.0], [170.0, -170.0]))
    np.testing.assert_allclose(azimuth, [170, 180, np.nan, -180, -170])
    np.testing.assert_allclose(elevation, [0, 5, np.nan, 5, 10], atol=1e-12)
    azimuth, _ = on_map(direction([0.0, 0.0], [20.0, -30.0]))
    assert len(azimuth) == 2


def test_the_nadir_image_runs_around_the_map_once() -> None:
    points = outline(CAMERA, rotation(20, -90), 96)
    azimuth, elevation = on_map(np.concatenate([points, points[:1]]))
    assert np.isnan(azimuth).sum() == 1
    assert np.nanmax(elevation) < -50
