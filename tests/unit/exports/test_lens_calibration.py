"""What fits of a lens become as keys of the camera profile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("PIL")

from panoexec.exports import lens_calibration
from panoexec.inputs.plan_file import camera_to_data
from panoexec.lens.distortion import Distortion
from panoexec.optics import Camera
from panoexec.pictures.lens import LensFit
from panoexec.planning.baselines.published import X5S_15MM

FIT = LensFit(
    focal_ratio=1.01,
    k1=-0.03,
    k2=0.004,
    centre=(0.02, -0.01),
    focal_sigma=2e-4,
    k1_sigma=1e-3,
    k2_sigma=1e-3,
    centre_sigma=(4e-4, 4e-4),
    points=1000,
    rms_px=0.3,
)
CALIBRATED = X5S_15MM.with_lens("calibrated")


def proposed(camera: Camera, fit: LensFit, monkeypatch: pytest.MonkeyPatch) -> lens_calibration.LensProposal:
    monkeypatch.setattr(lens_calibration, "_fit", lambda document, folder: fit)
    proposal = lens_calibration.propose_lens([({"camera": camera_to_data(camera)}, Path())])
    assert proposal is not None
    return proposal


@pytest.mark.parametrize("camera", [X5S_15MM, CALIBRATED], ids=["nominal", "calibrated"])
def test_the_focal_length_is_relative_to_the_lens_that_the_mission_was_planned_for(
    camera: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = proposed(camera, FIT, monkeypatch)
    assert found.focal_length_mm == pytest.approx(camera.focal_length_used_mm * 1.01)


@pytest.mark.parametrize("mounted", [CALIBRATED, CALIBRATED.rotated()], ids=["landscape", "portrait"])
def test_the_proposed_keys_put_the_principal_point_where_the_fit_has_it(
    mounted: Camera, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = proposed(mounted, FIT, monkeypatch)
    assert found.principal_point_px is not None
    # a profile with these keys, mounted as the camera was
    profile = replace(
        CALIBRATED,
        calibrated_focal_length_mm=found.focal_length_mm,
        distortion=Distortion(k1=found.k1, k2=found.k2),
        principal_point_px=found.principal_point_px,
        fov_margin=found.fov_margin,
    )
    again = profile.rotated() if mounted.is_portrait else profile
    sides = again.sides
    assert (sides.left - sides.right) / 2 == pytest.approx(0.02, abs=1e-3)
    assert (sides.top - sides.bottom) / 2 == pytest.approx(-0.01, abs=1e-3)
    assert again.half_width > 0


def test_a_principal_point_within_its_error_is_the_middle_and_the_margin_covers_what_is_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unsure = replace(FIT, centre=(0.001, 0.0), centre_sigma=(0.002, 0.002))
    found = proposed(CALIBRATED, unsure, monkeypatch)
    assert found.principal_point_px is None
    corner = 0.7232 / 1.01  # of this camera, focal lengths
    three_sigmas = 3 * (2e-4 / 1.01 + 1e-3 * corner**2 + 1e-3 * corner**4)
    assert 2 * three_sigmas <= found.fov_margin <= 2 * three_sigmas + 0.0015
    assert proposed(CALIBRATED, FIT, monkeypatch).fov_margin > found.fov_margin
