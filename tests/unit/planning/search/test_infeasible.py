"""Each reason for a refusal: what it says, and that the request next to it, which has not that reason, is planned."""

from __future__ import annotations

import re

import pytest

from panoexec.optics import Camera
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Tolerance
from panoexec.planning.search import infeasible
from panoexec.planning.search.infeasible import empty_cores, excessive_overlap, infeasibility_error, nothing_to_cover
from panoexec.planning.search.planner import plan_certified

WIDE = Camera.from_fov(60.0, 47.0)
VERY_WIDE = Camera.from_fov(100.0, 80.0)

Range = tuple[float, float]


def asked(
    low_deg: float,
    high_deg: float,
    azimuth_deg: Range = (-180.0, 180.0),
    *,
    overlap: Range = (0.2, 0.2),
    tolerance: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gimbal: GimbalLimits | None = None,
    masks: tuple[AngleBox, ...] = (),
    sure: bool = False,
) -> Constraints:
    band = Band(
        elevation_min_deg=low_deg,
        elevation_max_deg=high_deg,
        azimuth_min_deg=azimuth_deg[0],
        azimuth_max_deg=azimuth_deg[1],
    )
    pitch, roll, yaw = tolerance
    return Constraints(
        overlap_h=overlap[0],
        overlap_v=overlap[1],
        band=band,
        tolerance=Tolerance(pitch_deg=pitch, roll_deg=roll, yaw_deg=yaw),
        guarantee="all" if sure else "coverage",
        gimbal=gimbal,
        masks=masks,
    )


def pans(low_deg: float, high_deg: float) -> GimbalLimits:
    return GimbalLimits(yaw_min_deg=low_deg, yaw_max_deg=high_deg, yaw_endless=False)


def figures(pattern: str, text: str) -> list[float]:
    """The numbers that a pattern finds in a text, which it must match."""
    found = re.search(pattern, text)
    assert found, text
    return [float(number) for number in found.groups()]


def is_planned(camera: Camera, constraints: Constraints) -> bool:
    certificate = plan_certified(camera, constraints).certificate
    return certificate is not None and certificate.certified


class TestNothingToCover:
    def test_masks_that_leave_nothing(self) -> None:
        def masked(top_deg: float, right_deg: float) -> Constraints:
            box = AngleBox(
                elevation_min_deg=-90, elevation_max_deg=top_deg, azimuth_min_deg=0, azimuth_max_deg=right_deg
            )
            return asked(-40, 10, (20, 80), masks=(box,))

        text = nothing_to_cover(masked(10, 80))
        assert text is not None
        assert "masks leave nothing" in text
        assert "larger band or smaller masks" in text
        assert nothing_to_cover(masked(9, 80)) is None
        assert nothing_to_cover(masked(10, 79)) is None

    def test_no_masks_leave_all(self) -> None:
        assert nothing_to_cover(asked(-90, 90)) is None


class TestTooDense:
    @pytest.mark.parametrize(("band", "overlap", "least"), [((-30.0, 30.0), 0.999, 0.99), ((50.0, 60.0), 0.9995, 0.99)])
    def test_more_images_in_a_row_than_anybody_takes(self, band: Range, overlap: float, least: float) -> None:
        text = excessive_overlap(WIDE, asked(*band, overlap=(overlap, 0.0)))
        assert text == f"horizontal overlap {overlap:g} needs more than 5000 images in one row: ask for less overlap"
        assert excessive_overlap(WIDE, asked(*band, overlap=(least, 0.0))) is None

    def test_each_direction_in_more_images_than_anybody_takes(self) -> None:
        text = excessive_overlap(WIDE, asked(-90, 90, overlap=(0.95, 0.96)))
        assert text is not None
        assert "overlaps of 0.95 in rows and 0.96 between rows" in text
        assert figures(r"in about (\d+) images, (\d+) above", text) == [500, 400]
        assert excessive_overlap(WIDE, asked(-90, 90, overlap=(0.9, 0.9))) is None
        assert excessive_overlap(WIDE, asked(-90, 90, overlap=(0.9, 0.901))) is not None

    def test_more_rows_than_anybody_takes(self) -> None:
        narrow = Camera.from_fov(1.5, 1.0)
        text = excessive_overlap(narrow, asked(-60, 60, overlap=(0.0, 0.99)))
        assert text == "vertical overlap 0.99 needs more than 5000 rows: ask for less overlap"
        # 0.01 degrees each
        assert excessive_overlap(narrow, asked(-60, -11, overlap=(0.0, 0.99))) is None
        assert excessive_overlap(narrow, asked(-60, -9, overlap=(0.0, 0.99))) == text
        assert excessive_overlap(narrow, asked(-60, 60, overlap=(0.0, 0.97))) is None


class TestTolerance:
    def test_tolerances_that_leave_nothing_of_an_image(self) -> None:
        narrow = Camera.from_fov(8.0, 3.0)
        text = empty_cores(narrow, asked(-60, 0, tolerance=(2.0, 1.0, 0.5)))
        assert text is not None
        assert "2° (pitch), 1° (roll) and 0.5° (yaw)" in text
        assert "an image of 8° x 3°" in text
        assert figures(r"pitch must stay below ([\d.]+)°, roll and yaw well below ([\d.]+)°", text) == [1.5, 4.0]
        assert empty_cores(narrow, asked(-60, 0, tolerance=(1.4, 0.0, 0.0))) is None
        assert empty_cores(narrow, asked(-60, 0, tolerance=(1.6, 0.0, 0.0))) is not None
        assert empty_cores(narrow, asked(-60, 0)) is None
        assert str(infeasibility_error(narrow, asked(-60, 0, tolerance=(2.0, 1.0, 0.5)))) == text

    def test_a_yaw_tolerance_that_eats_images_at_the_horizon_leaves_some_at_the_nadir(self) -> None:
        assert empty_cores(WIDE, asked(-90, -60, tolerance=(0.0, 0.0, 35.0))) is None

    def test_an_image_that_sees_all_needs_no_neighbours(self) -> None:
        assert empty_cores(WIDE, asked(-5, 5, (-5, 5), tolerance=(1.0, 1.0, 1.0))) is None

    def test_tolerances_with_which_no_rows_close(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(infeasible, "_BISECTIONS", 3)
        tau = 30.0
        text = str(infeasibility_error(VERY_WIDE, asked(-5, 5, overlap=(0.0, 0.0), tolerance=(tau, 0.0, 0.0))))
        assert "30° (pitch), 0° (roll) and 0° (yaw)" in text
        assert "100° x 80°" in text
        (share,) = figures(r"about (\d+)% of these tolerances would be feasible", text)
        assert 0 < share < 100
        less = tau * (share - 1) / 100
        assert is_planned(VERY_WIDE, asked(-5, 5, overlap=(0.0, 0.0), tolerance=(less, 0.0, 0.0)))


class TestGimbal:
    def test_a_gimbal_that_cannot_look_so_high(self) -> None:
        gimbal = GimbalLimits(pitch_max_deg=20.0)
        top, reach, short = figures(
            r"elevation (\d+)° cannot be covered: at the gimbal's highest pitch 20° "
            r"images cover all azimuths up to ([\d.]+)°, ([\d.]+)° short",
            str(infeasibility_error(WIDE, asked(-30, 50, gimbal=gimbal))),
        )
        assert top == 50
        assert reach + short == pytest.approx(top, abs=0.011)
        assert is_planned(WIDE, asked(-30, reach - 0.1, gimbal=gimbal))
        assert figures(r"up to ([\d.]+)°", str(infeasibility_error(WIDE, asked(-30, reach + 0.2, gimbal=gimbal)))) == [
            reach
        ]

    def test_a_gimbal_that_cannot_look_so_low(self) -> None:
        gimbal = GimbalLimits(pitch_min_deg=-60.0)
        text = str(infeasibility_error(WIDE, asked(-90, -30, gimbal=gimbal)))
        bottom, reach, short = figures(
            r"elevation (-\d+)° cannot be covered: at the gimbal's lowest pitch -60° "
            r"images cover all azimuths down to (-[\d.]+)°, ([\d.]+)° short",
            text,
        )
        assert bottom == -90
        assert reach - short == pytest.approx(bottom, abs=0.011)
        # what the text asks for, and the last that it says can be had
        (instead,) = figures(r"ask for elevations from (-[\d.]+) to -30°", text)
        assert instead == pytest.approx(reach, abs=0.16)
        for low in (instead, reach + 0.01):
            assert is_planned(WIDE, asked(low, -30, gimbal=gimbal))

    @pytest.mark.parametrize("azimuth", [(-180.0, 180.0), (-60.0, 60.0)], ids=["around", "sector"])
    @pytest.mark.parametrize("up", [False, True], ids=["low", "high"])
    def test_more_images_than_overlap_demands_see_a_little_more_beyond_the_limit(
        self, azimuth: Range, *, up: bool
    ) -> None:
        band = (30.0, 83.31) if up else (-83.31, -30.0)
        gimbal = GimbalLimits(pitch_max_deg=60.0) if up else GimbalLimits(pitch_min_deg=-60.0)
        assert is_planned(WIDE, asked(*band, azimuth, gimbal=gimbal))

    def test_a_pitch_range_in_which_rows_do_not_stand(self) -> None:
        gimbal = GimbalLimits(pitch_min_deg=-20.0, pitch_max_deg=-20.0)
        text = str(infeasibility_error(WIDE, asked(-60, 10, gimbal=gimbal)))
        assert "elevation -60° cannot be covered: at the gimbal's lowest pitch -20°" in text

    def test_a_blind_arc_that_neighbours_cannot_bridge(self) -> None:
        text = str(infeasibility_error(WIDE, asked(-30, 20, gimbal=pans(-140, 140))))
        blind, percent, widest, more = figures(
            r"pans from -140 to 140°, which leaves a gap of ([\d.]+)° between neighbours, but with an overlap of "
            r"(\d+)% images at "
            r"the horizon may be at most ([\d.]+)° apart \(([\d.]+)° too much\)",
            text,
        )
        assert (blind, percent) == (80, 20)
        assert widest + more == pytest.approx(blind, abs=0.06)
        assert "an azimuth sector within the pan range" in text
        assert "yaw: auto" in text
        half = 180 - widest / 2
        assert is_planned(WIDE, asked(-5, 5, gimbal=pans(-half - 0.1, half + 0.1)))
        assert "leaves a gap" in str(infeasibility_error(WIDE, asked(-5, 5, gimbal=pans(-half + 0.5, half - 0.5))))
        # what the text asks for
        assert is_planned(WIDE, asked(-30, 20, (-140, 140), gimbal=pans(-140, 140)))

    def test_a_sector_outside_the_pan_range(self) -> None:
        text = str(infeasibility_error(WIDE, asked(-30, 20, (110, 250), gimbal=pans(-100, 100))))
        assert text == (
            "the gimbal pans from -100 to 100°: images of 60° do not reach the ends of azimuths 110 to 250°, outside "
            "this range, from there: ask for an azimuth sector within the pan range, or let the vehicle pan the rest "
            "(yaw: auto)"
        )
        assert is_planned(WIDE, asked(-30, 20, (60, 125), gimbal=pans(-100, 100)))
        # outside, but in sight of an image at the end of the pan range
        assert is_planned(WIDE, asked(-20, 15, (102, 125), gimbal=pans(-100, 100)))

    @pytest.mark.parametrize(("end", "planned"), [(49.0, True), (52.0, False)])
    def test_a_sector_whose_ends_images_do_not_reach(self, end: float, planned: bool) -> None:
        constraints = asked(-5, 5, (-end, end), gimbal=pans(-20, 20))
        if planned:
            assert is_planned(WIDE, constraints)
            return
        text = str(infeasibility_error(WIDE, constraints))
        assert text == (
            "the gimbal pans from -20 to 20°: images of 60° do not reach the ends of azimuths -52 to 52° from there: "
            "ask for an azimuth sector around 0°, or let the vehicle pan the rest (yaw: auto)"
        )


class TestOverlap:
    @pytest.fixture(autouse=True)
    def _roughly(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(infeasible, "_BISECTIONS", 3)

    @pytest.mark.parametrize("name", ["horizontal", "vertical"])
    def test_an_overlap_that_cannot_be_had_with_the_tolerances(self, name: str) -> None:
        def constraints(overlap: float) -> Constraints:
            both = (overlap, 0.0) if name == "horizontal" else (0.0, overlap)
            band = (-5.0, 5.0, (-180.0, 180.0)) if name == "horizontal" else (-60.0, 30.0, (-20.0, 20.0))
            return asked(*band, overlap=both, tolerance=(8.0, 0.0, 0.0), sure=True)

        text = str(infeasibility_error(VERY_WIDE, constraints(0.8)))
        value, most, less = figures(
            rf"a {name} overlap of ([\d.]+) for every pointing error is infeasible with these tolerances: "
            r"the maximum is about ([\d.]+), ([\d.]+) less",
            text,
        )
        assert value == 0.8
        assert most + less == pytest.approx(value, abs=0.011)
        assert 0 < most < 0.8
        # far enough below the bound, which is of C1 to C3 alone, that the plan needs no more images for C4
        assert is_planned(VERY_WIDE, constraints(most - (0.1 if name == "vertical" else 0.03)))

    def test_overlaps_that_cannot_both_be_had(self) -> None:
        text = str(
            infeasibility_error(VERY_WIDE, asked(-60, 30, overlap=(0.8, 0.7), tolerance=(12.0, 0.0, 0.0), sure=True))
        )
        assert text == "overlaps of 0.8 and 0.7 for every pointing error are infeasible together"
