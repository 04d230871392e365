import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.angles import rotation
from panoexec.errors import PlanningError
from panoexec.optics import Camera
from panoexec.planning.baselines.paper import pan_step_deg, plan_paper, tilt_step_deg
from panoexec.planning.baselines.published import A6000_35MM, X5S_15MM, X5S_45MM
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.geometry.overlap import pairwise_overlap
from panoexec.planning.model import Band, Constraints, GimbalLimits, Plan
from tests.unit.planning.sampling import directions_in, uncovered


def wanted(
    low: float = -90.0, high: float = 30.0, overlap: float = 0.15, azimuth: tuple[float, float] = (-180, 180)
) -> Constraints:
    band = Band(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=azimuth[0], azimuth_max_deg=azimuth[1])
    return Constraints(overlap_h=overlap, overlap_v=overlap, band=band)


def rows_of(plan: Plan) -> list[tuple[float, int]]:
    return [(pitch, len(shots)) for pitch, shots in plan.rows()]


class TestAlgorithms:
    @pytest.mark.parametrize(("camera", "step"), [(X5S_15MM, 40.2), (X5S_45MM, 14.0), (A6000_35MM, 21.4)])
    def test_algorithm_1_steps_as_the_geometry_says(self, camera: Camera, step: float) -> None:
        assert tilt_step_deg(camera, 0.15) == pytest.approx(step, abs=0.06)

    @pytest.mark.parametrize(
        ("camera", "pitches", "counts"),
        [
            (X5S_15MM, [30, -5, -39, -70], [7, 7, 6, 2]),
            (X5S_45MM, [30, 18, 5, -7, -20, -32, -43, -55, -66, -78], [17, 19, 20, 20, 19, 17, 15, 12, 9, 5]),
            (A6000_35MM, [0, -21, -40, -57, -75], [12, 11, 9, 7, 4]),
        ],
    )
    def test_algorithm_2_counts_in_the_published_rows(
        self, camera: Camera, pitches: list[float], counts: list[int]
    ) -> None:
        """What the published rows would need at 15 %, worked out independently from the intended geometry."""
        assert [int(np.ceil(360 / pan_step_deg(camera, pitch, 0.15))) for pitch in pitches] == counts

    @given(st.floats(10, 100), st.floats(10, 100), st.floats(0.01, 0.9), st.floats(-85, 85))
    @settings(max_examples=50)
    def test_a_step_is_the_largest_angle_with_the_overlap(
        self, hfov: float, vfov: float, overlap: float, pitch: float
    ) -> None:
        camera = Camera.from_fov(hfov, vfov)
        tilt = tilt_step_deg(camera, overlap)
        at, beyond = pairwise_overlap(camera, np.eye(3), rotation(0.0, np.array([tilt, tilt + 1e-3])))
        assert at >= overlap - 1e-9
        assert beyond < overlap
        pan = pan_step_deg(camera, pitch, overlap)
        fixed = rotation(0.0, pitch)
        assert pairwise_overlap(camera, fixed, rotation(np.linspace(0, pan, 200), pitch)).min() >= overlap - 1e-9
        if pan < 180:
            assert pairwise_overlap(camera, fixed, rotation(pan + 1e-3, pitch)) < overlap

    def test_thresholds_of_nothing_end_where_images_part(self) -> None:
        assert tilt_step_deg(X5S_15MM, 0.0) == pytest.approx(X5S_15MM.vfov_deg, abs=1e-3)


class TestPlans:
    def test_the_default_panorama(self) -> None:
        plan = plan_paper(X5S_15MM, wanted())
        assert (plan.method, len(plan.shots)) == ("paper", 19)
        pitches = [pitch for pitch, _ in plan.rows()]
        assert pitches[0] == -90.0
        assert np.diff(pitches)[1:] == pytest.approx(tilt_step_deg(X5S_15MM, 0.15))
        assert [shot.index for shot in plan.shots] == list(range(19))
        assert [count for _, count in rows_of(plan)] == [1, 4, 7, 7]
        # Algorithm 2 alone would put two images there, with holes between them
        assert any("4 images instead of Algorithm 2's 2" in note for note in plan.notes)
        certificate = certify(plan)
        assert certificate.uncovered_fraction == 0.0
        assert certificate.connected
        assert certificate.min_overlap_h is not None
        assert certificate.min_overlap_h >= 0.15

    @pytest.mark.parametrize(
        ("camera", "top", "images"), [(X5S_15MM, 50.5, 21), (X5S_45MM, 37.7, 134), (A6000_35MM, 12.2, 41)]
    )
    def test_the_papers_scenarios(self, camera: Camera, top: float, images: int) -> None:
        plan = plan_paper(camera, wanted(high=top))
        assert len(plan.shots) == images
        assert len(uncovered(plan, directions_in(plan.constraints.band, 20_000, np.random.default_rng(1)))) == 0

    @given(
        fov=st.tuples(st.floats(8, 110), st.floats(8, 110)),
        overlaps=st.tuples(st.floats(0, 0.6), st.floats(0, 0.6)),
        elevation=st.tuples(st.floats(-90, 90), st.floats(-90, 90)),
        to_nadir=st.booleans(),
        azimuth=st.none() | st.tuples(st.floats(-180, 180), st.floats(5, 355)),
        seed=st.integers(0, 2**32 - 1),
    )
    @settings(max_examples=40, deadline=None)
    def test_any_band_is_covered_at_the_planned_poses(
        self,
        fov: tuple[float, float],
        overlaps: tuple[float, float],
        elevation: tuple[float, float],
        to_nadir: bool,
        azimuth: tuple[float, float] | None,
        seed: int,
    ) -> None:
        low, high = sorted(elevation)
        low = -90.0 if to_nadir else low
        if high - low < 0.5:
            return
        start, span = azimuth or (-180.0, 360.0)
        band = Band(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=start, azimuth_max_deg=start + span)
        constraints = Constraints(overlap_h=overlaps[0], overlap_v=overlaps[1], band=band)
        plan = plan_paper(Camera.from_fov(*fov), constraints)
        assert len(uncovered(plan, directions_in(band, 5000, np.random.default_rng(seed)))) == 0
        for _, shots in plan.rows():
            if len(shots) > 1 and band.is_full_circle:
                turns = rotation(np.array([s.yaw_deg for s in shots]), shots[0].pitch_deg)
                overlap = pairwise_overlap(plan.camera, turns, np.roll(turns, -1, axis=0))
                assert overlap.min() >= overlaps[0] - 1e-7  # the closing pair included

    def test_a_sector_stays_in_its_azimuths(self) -> None:
        plan = plan_paper(X5S_45MM, wanted(-90, 0, azimuth=(170, 260)))
        assert len(plan.shots) < 30
        yaws = np.array([shot.yaw_deg for shot in plan.shots if shot.pitch_deg > -89])
        assert ((yaws % 360 > 170) & (yaws % 360 < 260)).all()

    def test_small_sectors_take_one_image(self) -> None:
        assert len(plan_paper(X5S_15MM, wanted(-10, 10, azimuth=(0, 30))).shots) == 1

    def test_rows_are_shot_from_the_top_to_and_fro(self) -> None:
        plan = plan_paper(X5S_45MM, wanted())
        pitches = [shot.pitch_deg for shot in plan.shots]
        assert pitches == sorted(pitches, reverse=True)
        last_row = max(shot.row for shot in plan.shots)
        by_row = {row: [s.yaw_deg for s in plan.shots if s.row == row] for row in range(1, last_row + 1)}
        assert by_row[last_row] == sorted(by_row[last_row])
        assert by_row[last_row - 1] == sorted(by_row[last_row - 1], reverse=True)

    def test_rows_never_gain_images_without_saying_so(self) -> None:
        plan = plan_paper(A6000_35MM, wanted(high=12.2))
        assert plan.notes == ()
        counts = [count for _, count in rows_of(plan)]
        assert counts == [1, 2, 6, 9, 11, 12]


class TestRefusals:
    @pytest.mark.parametrize("overlap", [1.0, 1.2, 15, -0.1, float("nan")])
    def test_overlaps_are_fractions(self, overlap: float) -> None:
        with pytest.raises(PlanningError, match=r"overlap .* fraction"):
            plan_paper(X5S_15MM, wanted(overlap=overlap))

    def test_a_percentage_is_recognised(self) -> None:
        with pytest.raises(PlanningError, match=r"15 % is 0\.15"):
            plan_paper(X5S_15MM, wanted(overlap=15))

    def test_more_images_than_a_mission_can_hold(self) -> None:
        with pytest.raises(PlanningError, match=r"the plan needs \d+ images"):
            plan_paper(Camera.from_fov(1.0, 0.8), wanted(overlap=0.5))

    def test_gimbals_that_do_not_reach(self) -> None:
        limits = GimbalLimits(pitch_min_deg=-45, pitch_max_deg=45)
        constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=wanted().band, gimbal=limits)
        with pytest.raises(PlanningError, match=r"needs a row at pitch -.*, the gimbal reaches -45 to 45"):
            plan_paper(X5S_15MM, constraints)
        stops = GimbalLimits(yaw_min_deg=-160, yaw_max_deg=160, yaw_endless=False)
        constraints = Constraints(overlap_h=0.15, overlap_v=0.15, band=wanted().band, gimbal=stops)
        with pytest.raises(PlanningError, match="pans from -160 to 160"):
            plan_paper(X5S_15MM, constraints)
