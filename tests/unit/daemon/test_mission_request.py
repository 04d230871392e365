"""From a request and the configuration to what is planned, and to the settings that it is flown with."""

from __future__ import annotations

from typing import Any

import pytest

from panoexec.daemon.mission_request import configuration_problems, settings_of, spec_of
from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import plan_to_data
from panoexec.inputs.plan_options import configured_gimbal
from panoexec.mission.preflight import effective_limits
from panoexec.mqtt.requests import PlanRequest, RefusedRequestError
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.model import AngleBox, Band, GimbalLimits, Tolerance

CONFIG = Config.model_validate({"mission": {"overlap_h": 0.2, "method": "paper", "order": "rows"}})
SENSOR = {"sensor_width_mm": 36.0, "sensor_height_mm": 24.0, "image_width_px": 6000, "image_height_px": 4000}


def config(**gimbal: Any) -> Config:
    return Config.model_validate({"gimbal": gimbal, "vehicle": {"connection": "udpin://0.0.0.0:1"}})


def request(**fields: Any) -> PlanRequest:
    return PlanRequest.model_validate({"transaction": "t"} | fields)


def test_what_a_request_leaves_out_comes_from_the_configuration() -> None:
    spec = spec_of(CONFIG, request(overlap_v=0.3, tolerance_deg={"yaw": 1.5}, azimuth_deg=[0, 90]))
    constraints = spec.constraints
    assert (constraints.overlap_h, constraints.overlap_v) == (0.2, 0.3)
    assert constraints.tolerance == Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=1.5)
    assert constraints.band == Band(
        elevation_min_deg=-90.0, elevation_max_deg=30.0, azimuth_min_deg=0.0, azimuth_max_deg=90.0
    )
    assert (spec.method, spec.order, spec.given) == ("paper", "rows", None)
    assert constraints.gimbal == GimbalLimits()


def test_what_a_request_says_reaches_the_specification() -> None:
    asked = request(overlap=0.4, elevation_deg=[-10, 10], guarantee="all", method="certified", order="columns")
    spec = spec_of(CONFIG, asked)
    assert (spec.constraints.overlap_h, spec.constraints.overlap_v) == (0.4, 0.4)
    assert (spec.constraints.band.elevation_min_deg, spec.constraints.band.elevation_max_deg) == (-10, 10)
    assert (spec.constraints.guarantee, spec.method, spec.order) == ("all", "certified", "columns")


def test_a_plan_in_the_request_is_judged_for_its_own_camera_and_constraints() -> None:
    plan = published_plan("scenario-3-proposed")
    mask = AngleBox(elevation_min_deg=-90.0, elevation_max_deg=-80.0, azimuth_min_deg=0.0, azimuth_max_deg=90.0)
    data = plan_to_data(plan)
    data["constraints"]["masks"] = [{"elevation_deg": [-90, -80], "azimuth_deg": [0, 90]}]
    spec = spec_of(CONFIG, request(plan=data, overlap_v=0.1), camera="dji-x5s-45mm")
    assert spec.given is not None
    assert spec.given.shots == plan.shots
    assert spec.given.camera == spec.camera == plan.camera
    assert spec.given.constraints == spec.constraints
    assert (spec.constraints.overlap_h, spec.constraints.overlap_v) == (0.15, 0.1)
    assert spec.constraints.masks == (mask,)
    assert spec.constraints.tolerance == plan.constraints.tolerance
    assert spec.constraints.gimbal == configured_gimbal(CONFIG)
    # what a shot costs is the mounted camera's business, whatever the file calls it
    assert spec.timing.interval_s == load_profile("dji-x5s-45mm").min_interval_s
    named = spec_of(CONFIG, request(plan=data, camera="dji-x5s-15mm"))
    assert named.given is not None
    assert named.given.camera == load_profile("dji-x5s-15mm").camera


def test_the_camera_of_a_request_wins_over_the_one_set_before_and_the_configured_one() -> None:
    assert spec_of(CONFIG, request()).camera.name == "dji-x5s-15mm"
    assert spec_of(CONFIG, request(), camera="dji-x5s-45mm").camera.name == "dji-x5s-45mm"
    table = SENSOR | {"name": "mine", "focal_length_mm": 35.0}
    assert spec_of(CONFIG, request(camera=table), camera="dji-x5s-45mm").camera.name == "mine"


def test_the_lens_of_a_request_wins_over_the_configured_one() -> None:
    nominal = Config.model_validate({"camera": {"profile": "dji-x5s-45mm", "lens": "nominal"}})
    known = Config.model_validate({"camera": {"profile": "dji-x5s-45mm"}})
    assert spec_of(known, request()).camera.focal_length_used_mm == 46.0
    assert spec_of(nominal, request()).camera.focal_length_used_mm == 45.0
    assert spec_of(nominal, request(lens="calibrated")).camera.focal_length_used_mm == 46.0
    assert spec_of(nominal, request(camera="dji-x5s-15mm")).camera.focal_length_used_mm == 15.0
    assert spec_of(known, request(camera="dji-x5s-15mm", lens="nominal")).camera.focal_length_used_mm == 15.0
    # a plan is for the lens that it states, unless the request states another
    data = plan_to_data(published_plan("scenario-2-proposed"))
    assert spec_of(known, request(plan=data)).camera.focal_length_used_mm == 45.0
    assert spec_of(known, request(plan=data, lens="calibrated")).camera.focal_length_used_mm == 46.0
    unknown = Config.model_validate({"camera": {"profile": "siyi-a8-mini", "lens": "calibrated"}})
    assert any("siyi-a8-mini has no calibrated lens" in text for text in configuration_problems(unknown))


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"camera": "siyi-a8-mini", "lens": "calibrated"}, "lens"),
        ({"camera": SENSOR | {"focal_length_mm": 20.0, "distortion": {"k1": -3.0}}}, "camera.distortion"),
        (
            {"camera": SENSOR | {"focal_length_mm": 20.0, "principal_point_px": [9000.0, 1.0]}},
            "camera.principal_point_px",
        ),
        ({"camera": "no-such-camera"}, "camera"),
        ({"camera": SENSOR}, "camera.focal_length_mm"),
        ({"plan": {"shots": []}}, "plan.shots"),
    ],
)
def test_what_is_wrong_is_refused_by_the_name_of_its_field(fields: dict[str, Any], field: str) -> None:
    with pytest.raises(RefusedRequestError) as caught:
        spec_of(CONFIG, request(**fields))
    assert (caught.value.code, caught.value.field) == ("invalid", field)


def test_a_vehicle_that_pans_ignores_what_the_gimbal_states_of_its_pan_axis_but_not_of_its_pitch() -> None:
    limits = configured_gimbal(config(yaw="vehicle", yaw_deg=[-160, 160], pitch_deg=[-90, 20]))
    own = GimbalLimits(pitch_min_deg=-120.0, pitch_max_deg=40.0)
    held = effective_limits(own, limits)
    assert (held.pitch_min_deg, held.pitch_max_deg, held.pans) == (-120.0, 40.0, False)


def test_auto_keeps_the_pan_range_that_is_stated() -> None:
    limits = configured_gimbal(config(yaw="auto", yaw_deg=[-160, 160]))
    own = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=0.0, yaw_endless=False)
    held = effective_limits(own, limits)
    assert not held.pans
    assert held.turning == limits.turning


@pytest.mark.parametrize("yaw", ["vehicle", "auto"])
def test_who_pans_is_no_problem_of_a_configuration_and_reaches_the_mission(yaw: str) -> None:
    wanted = config(yaw=yaw)
    assert configuration_problems(wanted) == []
    settings = settings_of(wanted, spec_of(wanted, request()))
    assert settings.gimbal.turning is not None
