import contextlib
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.camera_profiles import list_profiles, load_profile, profile_from_mapping
from tests.repository import ROOT

PROFILES = ROOT / "config" / "cameras"
GOOD: dict[str, Any] = {
    "sensor_width_mm": 17.3,
    "sensor_height_mm": 13.0,
    "image_width_px": 5280,
    "image_height_px": 3956,
    "focal_length_mm": 15.0,
    "source": "a data sheet",
}


class TestShipped:
    def test_the_config_folder_shows_them(self) -> None:
        names = [profile.camera.name for profile in list_profiles()]
        assert len(names) == 21
        assert names == sorted(names)
        assert names == sorted(path.stem for path in PROFILES.glob("*.toml"))

    @pytest.mark.parametrize(
        ("name", "hfov", "vfov", "panorama_width"),
        [
            ("dji-x5s-15mm", 59.94, 46.86, 28520),
            ("dji-x5s-45mm", 21.76, 16.44, 88280),
            ("sony-a6000-35mm", 37.12, 25.13, 56096),
        ],
    )
    def test_the_papers_three(self, name: str, hfov: float, vfov: float, panorama_width: int) -> None:
        camera = load_profile(name).camera.with_lens("nominal")
        assert camera.hfov_deg == pytest.approx(hfov, abs=0.006)
        assert camera.vfov_deg == pytest.approx(vfov, abs=0.006)
        assert camera.panorama_px()[0] == pytest.approx(panorama_width, rel=0.005)

    @pytest.mark.parametrize(
        ("name", "published_diagonal_deg", "within_deg"),
        [
            ("dji-mavic-3-enterprise-wide", 84.0, 1.5),
            ("dji-mavic-3-enterprise-tele", 15.0, 0.5),
            ("dji-phantom-4-pro", 84.0, 0.5),
            ("dji-zenmuse-p1-35mm", 63.5, 0.5),
            ("dji-zenmuse-h20-zoom", 66.6, 0.5),
            ("dji-zenmuse-x7-24mm", 61.0, 0.5),
            ("dji-mini-4-pro", 82.1, 0.5),
            ("raspberry-pi-hq-16mm", 27.6, 0.5),
        ],
    )
    def test_figures_agree_with_the_published_field_of_view(
        self, name: str, published_diagonal_deg: float, within_deg: float
    ) -> None:
        camera = load_profile(name).camera
        diagonal = math.degrees(2 * math.atan(math.hypot(camera.half_width, camera.half_height)))
        assert diagonal == pytest.approx(published_diagonal_deg, abs=within_deg)

    @pytest.mark.parametrize(("name", "published_deg"), [("siyi-a8-mini", 81.0), ("viewpro-z10-zoom", 53.0)])
    def test_figures_agree_with_the_published_horizontal_field_of_view(self, name: str, published_deg: float) -> None:
        assert load_profile(name).camera.hfov_deg == pytest.approx(published_deg, abs=0.1)

    def test_every_profile_has_a_source_and_square_pixels(self) -> None:
        for profile in list_profiles():
            camera = profile.camera
            assert len(profile.source) > 40
            assert profile.orientation == "landscape"
            assert 0.5 <= profile.min_interval_s <= 5
            assert 0 < profile.max_exposure_s <= 0.05
            across = camera.sensor_width_mm / camera.image_width_px
            assert camera.sensor_height_mm / camera.image_height_px == pytest.approx(across, rel=0.01)

    def test_no_profile_types_in_its_field_of_view(self) -> None:
        for path in PROFILES.glob("*.toml"):
            assert not [key for key in tomllib.loads(path.read_text()) if "fov" in key]


class TestUse:
    def test_portrait_turns_the_camera(self) -> None:
        landscape, portrait = load_profile("dji-x5s-15mm"), load_profile("dji-x5s-15mm", orientation="portrait")
        assert portrait.orientation == "portrait"
        assert portrait.camera.hfov_deg == landscape.camera.vfov_deg
        assert portrait.camera.image_width_px == 3956
        assert portrait.camera.panorama_px() == landscape.camera.panorama_px()

    def test_a_zoom_takes_a_focal_length(self) -> None:
        wide, tele = load_profile("dji-zenmuse-h20-zoom"), load_profile("dji-zenmuse-h20-zoom", focal_length_mm=100.0)
        assert wide.zoom_range_mm == (6.83, 119.94)
        assert wide.camera.focal_length_mm == 6.83
        assert tele.camera.hfov_deg == pytest.approx(4.11, abs=0.01)
        with pytest.raises(UsageError, match=r"zooms from 6\.83 to 119\.94"):
            load_profile("dji-zenmuse-h20-zoom", focal_length_mm=200.0)

    def test_a_fixed_lens_takes_no_other_focal_length(self) -> None:
        assert load_profile("dji-x5s-15mm", focal_length_mm=15.0).camera.focal_length_mm == 15.0
        with pytest.raises(UsageError, match="fixed lens of 15 mm"):
            load_profile("dji-x5s-15mm", focal_length_mm=25.0)

    @pytest.mark.parametrize(
        ("name", "near"),
        [("dji-x5s", "dji-x5s-15mm"), ("Sony-A6000-35mm", "sony-a6000-35mm"), ("xyz", "panoexec cameras")],
    )
    def test_an_unknown_name_brings_its_neighbours(self, name: str, near: str) -> None:
        with pytest.raises(UsageError, match=near) as raised:
            load_profile(name)
        assert "panoexec cameras" in str(raised.value)

    def test_a_file_of_ones_own(self, tmp_path: Path) -> None:
        path = tmp_path / "mine.toml"
        path.write_text((PROFILES / "dji-x5s-15mm.toml").read_text())
        assert load_profile(str(path)).camera.name == "mine"
        with pytest.raises(InputFileError, match=r"other\.toml: cannot be read"):
            load_profile(str(tmp_path / "other.toml"))
        path.write_text("sensor_width_mm = \nx = 1\n")
        with pytest.raises(InputFileError, match=r"mine\.toml: is not valid TOML: .*line 1"):
            load_profile(str(path))
        path.write_bytes(b"\xff\xfe")
        with pytest.raises(InputFileError, match="not UTF-8"):
            load_profile(str(path))


def without(*keys: str, **changes: Any) -> dict[str, Any]:
    return {key: value for key, value in GOOD.items() if key not in keys} | changes


class TestProblems:
    @pytest.mark.parametrize(
        ("data", "says"),
        [
            (without("sensor_width_mm"), "sensor_width_mm is missing"),
            (without("focal_length_mm"), "focal_length_mm is missing"),
            (without(sensor_width_mm=-17.3), "sensor_width_mm is -17.3: .*greater than 0"),
            (without(sensor_height_mm=0), "sensor_height_mm is 0"),
            (without(focal_length_mm=float("nan")), "focal_length_mm is nan: .*finite"),
            (without(focal_length_mm=1e9), "focal_length_mm is 1000000000"),
            (without(focal_length_mm="15"), "focal_length_mm is '15'"),
            (without(focal_length_mm=True), "focal_length_mm is True"),
            (without(image_width_px=5280.5), r"image_width_px is 5280\.5"),
            (without(orientation="diagonal"), "orientation is 'diagonal': .*'landscape' or 'portrait'"),
            (without(min_interval_s=-1), "min_interval_s is -1"),
            (without(max_exposure_s=0), "max_exposure_s is 0"),
            (without(hfov_deg=60.0), "hfov_deg is not a known key"),
            (without(source=""), "source is ''"),
            (without("focal_length_mm", zoom_range_mm=[50, 20]), "the shorter first"),
            (without("focal_length_mm", zoom_range_mm=[50]), "zoom_range_mm"),
            (without(zoom_range_mm=[20, 50]), "focal_length_mm is 15: it must lie within 20 to 50"),
            (without(zoom_range_mm=[10, 50], calibrated_focal_length_mm=14.9), "remove it"),
            (without(focal_length_mm=0.05), r"field of view of 179\.34"),
            (without(image_height_px=5280), "times as wide as high"),
            (
                without(sensor_width_mm=13.0, sensor_height_mm=17.3, image_width_px=3956, image_height_px=5280),
                "widths must be the longer sides",
            ),
        ],
    )
    def test_each_is_named(self, data: dict[str, Any], says: str) -> None:
        with pytest.raises(InputFileError, match=says) as raised:
            profile_from_mapping(data, source="camera.toml")
        assert str(raised.value).startswith("camera.toml: ")
        assert "\n" not in str(raised.value)
        assert raised.value.exit_code == 2

    def test_all_are_reported_at_once(self) -> None:
        with pytest.raises(InputFileError) as raised:
            profile_from_mapping({"sensor_width_mm": -1, "speed": 3}, source="x")
        text = str(raised.value)
        for key in (
            "sensor_width_mm is -1",
            "speed is not a known key",
            "image_width_px is missing",
            "focal_length_mm is",
        ):
            assert key in text
        assert len(raised.value.problems) == 6

    def test_the_source_is_optional_in_a_file_of_ones_own_and_in_a_request(self, tmp_path: Path) -> None:
        assert profile_from_mapping(without("source"), source="request").camera.name == "inline"
        path = tmp_path / "mine.toml"
        path.write_text("\n".join(f"{key} = {value}" for key, value in GOOD.items() if key != "source"))
        assert load_profile(str(path)).source == "not given"


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from([*GOOD, "zoom_range_mm", "orientation", "min_interval_s", "x"]), anything))
def test_nothing_but_a_profile_or_its_problems_comes_out(changes: dict[str, Any]) -> None:
    with contextlib.suppress(InputFileError):
        camera = profile_from_mapping(GOOD | changes, source="x").camera
        assert 0 < camera.hfov_deg < 180


@given(st.text(max_size=40) | st.text(max_size=10).map("{}.toml".format))
@example("\0.toml")
def test_any_name_is_a_profile_or_a_clear_error(name: str) -> None:
    said, fov_deg = "", 0.0
    try:
        fov_deg = load_profile(name).camera.hfov_deg
    except UsageError as error:
        said = str(error)
    assert bool(said) != (0 < fov_deg < 180)
