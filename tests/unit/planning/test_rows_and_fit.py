from dataclasses import replace

import pytest

from panoexec.errors import PlanningError
from panoexec.planning.baselines.paper import plan_paper
from panoexec.planning.baselines.published import X5S_15MM, published_plan
from panoexec.planning.fit import what_would_fit
from panoexec.planning.model import Band, Constraints, GimbalLimits, Plan, Shot, Timing
from panoexec.planning.order.duration import estimate
from panoexec.planning.rows import row_table

WANTED = Constraints(overlap_h=0.15, overlap_v=0.15, band=Band(elevation_min_deg=-90, elevation_max_deg=30))


class TestRows:
    def test_the_published_scenario_2(self) -> None:
        """Overlaps worked out one pair at a time; the rows from -32° to -66° fall below the 15 % asked for."""
        rows = row_table(published_plan("scenario-2-proposed"))
        assert [row.number for row in rows] == list(range(11))
        below = {
            round(row.pitch_deg): row.overlap_h for row in rows if row.overlap_h is not None and row.overlap_h < 0.15
        }
        assert below == {
            -32: pytest.approx(0.122, abs=5e-4),
            -43: pytest.approx(0.131, abs=5e-4),
            -55: pytest.approx(0.127, abs=5e-4),
            -66: pytest.approx(0.145, abs=5e-4),
        }
        assert (rows[0].overlap_h, rows[0].spacing_deg, rows[0].overlap_below) == (None, None, None)
        assert rows[5].spacing_deg == pytest.approx(22.5)
        assert all(row.overlap_below is not None and 0.15 < row.overlap_below < 0.4 for row in rows[1:])

    def test_a_sectors_row_is_not_closed(self) -> None:
        sector = replace(
            WANTED, band=Band(elevation_min_deg=-5, elevation_max_deg=5, azimuth_min_deg=150, azimuth_max_deg=290)
        )
        shots = tuple(Shot(index=i, row=0, pitch_deg=0.0, yaw_deg=yaw) for i, yaw in enumerate((-160.0, 160.0, -120.0)))
        (row,) = row_table(Plan(method="foreign", camera=X5S_15MM, constraints=sector, shots=shots))
        assert row.spacing_deg == pytest.approx(40)
        assert row.overlap_h is not None
        assert row.overlap_h > 0.3
        (closed,) = row_table(Plan(method="foreign", camera=X5S_15MM, constraints=WANTED, shots=shots))
        assert closed.spacing_deg == pytest.approx(80)
        assert closed.overlap_h == 0


def planned(constraints: Constraints) -> Plan:
    plan = plan_paper(X5S_15MM, constraints)
    return replace(plan, estimate=estimate(plan.shots, X5S_15MM, GimbalLimits(), Timing()))


class TestFit:
    def test_what_it_names_fits_and_a_little_more_does_not(self) -> None:
        wanted = replace(WANTED, overlap_h=0.4, overlap_v=0.4)
        text = what_would_fit(wanted, planned, max_images=30, max_duration_s=None)
        assert text.endswith("would fit")
        overlap = float(text.split("--overlap ")[1].split()[0])
        assert len(planned(replace(WANTED, overlap_h=overlap, overlap_v=overlap)).shots) <= 30
        more = round(overlap + 0.01, 2)
        assert len(planned(replace(WANTED, overlap_h=more, overlap_v=more)).shots) > 30
        top = float(text.split("--elevation -90 ")[1].split()[0])
        assert len(planned(replace(wanted, band=replace(WANTED.band, elevation_max_deg=top))).shots) <= 30
        assert len(planned(replace(wanted, band=replace(WANTED.band, elevation_max_deg=top + 1))).shots) > 30

    def test_unequal_overlaps_keep_their_proportion(self) -> None:
        text = what_would_fit(
            replace(WANTED, overlap_h=0.5, overlap_v=0.25), planned, max_images=25, max_duration_s=None
        )
        horizontal = float(text.split("--overlap-h ")[1].split()[0])
        vertical = float(text.split("--overlap-v ")[1].split()[0])
        assert vertical == pytest.approx(horizontal / 2, abs=0.01)

    def test_durations_count_too(self) -> None:
        whole = planned(WANTED)
        assert whole.estimate is not None
        text = what_would_fit(WANTED, planned, max_images=None, max_duration_s=0.8 * whole.estimate.duration_s)
        assert "--elevation -90" in text

    def test_nothing_may_fit(self) -> None:
        assert "no overlap and no lower band would fit" in what_would_fit(
            WANTED, planned, max_images=None, max_duration_s=0.1
        )

    def test_requests_that_cannot_be_planned_do_not_fit(self) -> None:
        def never(_: Constraints) -> Plan:
            raise PlanningError("no")

        assert "no overlap" in what_would_fit(WANTED, never, max_images=10, max_duration_s=None)
