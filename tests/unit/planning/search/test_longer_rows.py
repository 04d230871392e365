"""Rows that lose overlap to the sky get more images, where nothing else is certified."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from panoexec.optics import Camera
from panoexec.planning.model import Band, Constraints, Tolerance
from panoexec.planning.search import planner
from panoexec.planning.search.longer_rows import Lengthened, with_longer_row
from panoexec.planning.search.planner import plan_certified
from panoexec.planning.search.proposal import Found, row_shots, verdict
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows
from panoexec.planning.search.variants import variants
from panoexec.planning.skyline import Skyline

CAMERA = Camera.from_fov(15.15, 22.56)
SKY = Constraints(
    overlap_h=0.1,
    overlap_v=0.1,
    band=Band(elevation_min_deg=-50.0, elevation_max_deg=30.0),
    tolerance=Tolerance(pitch_deg=1.92, roll_deg=1.85, yaw_deg=0.55),
    guarantee="all",
    textured_below=Skyline.level(5.7),
)
PATH = ((-22.2, 34), (-8.8, 33), (6.0, 33))


def proposed(path: tuple[tuple[float, int], ...]) -> Lengthened:
    rules = RowConstraints(CAMERA, SKY, next(variants(CAMERA, SKY)).demands)
    pitch, count = zip(*path, strict=True)
    shots = row_shots(rules, Rows(pitch_deg=pitch, count=count, phase_deg=(0.0,) * len(path), margin=0.0))
    return Lengthened(path, Found(shots, verdict(CAMERA, SKY, shots)))


def test_the_row_at_the_skyline_gets_more_images_until_its_neighbours_overlap_enough() -> None:
    now, before = proposed(PATH), None
    counts = [PATH[2][1]]
    for _ in range(6):
        longer = with_longer_row(now, before, SKY)
        if not longer:
            break
        assert [row for row, (old, new) in enumerate(zip(now.path, longer, strict=True)) if old != new] == [2]
        counts.append(longer[2][1])
        before, now = now, proposed(tuple(longer))
    least = now.found.certificate.worst_overlap_h
    assert least is not None
    assert least >= SKY.overlap_h - 1e-9
    assert counts == sorted(set(counts))
    assert 2 < len(counts) <= 5
    # and not many more than it needs
    fewer = proposed((*PATH[:2], (PATH[2][0], counts[-1] - 3))).found.certificate.worst_overlap_h
    assert fewer is not None
    assert fewer < SKY.overlap_h


def test_rows_whose_neighbours_overlap_enough_stay_as_they_are() -> None:
    assert with_longer_row(proposed((PATH[0],)), None, SKY) == []


def test_a_request_whose_row_at_the_skyline_lacks_overlap_is_certified(monkeypatch: pytest.MonkeyPatch) -> None:
    # the request itself is searched once, and nothing else
    monkeypatch.setattr(planner, "siblings", lambda _: iter(()))
    monkeypatch.setattr(planner, "variants", lambda *asked: itertools.islice(variants(*asked), 1))
    # seed 387 of the survey, without its mask
    plan = plan_certified(CAMERA, replace(SKY, band=Band(elevation_min_deg=-90.0, elevation_max_deg=62.0)))
    assert plan.certificate is not None
    assert plan.certificate.certified
    rows = [[shot for shot in plan.shots if shot.row == row] for row in sorted({shot.row for shot in plan.shots})]
    longest = max(rows, key=len)
    assert len(longest) > 34  # more than a row of whole images needs
    assert not longest[0].geometry_only
    assert 0.0 < longest[0].pitch_deg < 12.0
