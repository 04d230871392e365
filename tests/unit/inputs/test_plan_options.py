"""Options over a plan file over defaults, and what the configuration makes the defaults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.errors import UsageError
from panoexec.inputs.camera_profiles import configured_profile, load_profile
from panoexec.inputs.config import Config
from panoexec.inputs.plan_file import PlanFile
from panoexec.inputs.plan_options import PlanOptions, configured_gimbal, configured_spec, configured_timing
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.optics import Camera, Lens
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Timing, Tolerance, Turning
from panoexec.planning.skyline import Skyline

CAMERAS = [load_profile(name).camera for name in ("dji-x5s-15mm", "dji-x5s-45mm", "sony-a6000-35mm")]

PLAIN = Constraints(overlap_h=0.15, overlap_v=0.15, band=Band(elevation_min_deg=-90, elevation_max_deg=0))

cameras = st.sampled_from(CAMERAS)
fractions = st.floats(0, 0.9)
pairs = st.tuples(st.floats(-90, 0), st.floats(1, 90))
errors = st.floats(0, 40)
skylines = st.builds(Skyline.level, st.floats(-90, 90))
guarantees = st.sampled_from(["coverage", "all"])
boxes = st.builds(
    lambda low, high: AngleBox(elevation_min_deg=low, elevation_max_deg=high, azimuth_min_deg=0, azimuth_max_deg=90),
    st.floats(-90, 0),
    st.floats(1, 90),
)
masks = st.lists(boxes, max_size=3).map(tuple)
limits = st.builds(GimbalLimits, pitch_min_deg=st.floats(-120, -90), pitch_max_deg=st.floats(0, 90))
methods = st.sampled_from(["certified", "paper", "hdrpano"])
orders = st.sampled_from(["fastest", "rows", "columns"])
counts = st.integers(1, 30)

VALUES: dict[str, st.SearchStrategy[Any]] = {
    "camera": cameras,
    "lens": st.just("nominal"),
    "overlap": fractions,
    "overlap_h": fractions,
    "overlap_v": fractions,
    "elevation_deg": pairs,
    "azimuth_deg": pairs,
    "tolerance_pitch_deg": errors,
    "tolerance_roll_deg": errors,
    "tolerance_yaw_deg": errors,
    "guarantee": guarantees,
    "masks": masks,
    "textured_below": skylines,
    "gimbal": limits,
    "method": methods,
    "order": orders,
    "columns": counts,
    "rows": counts,
    "budget_s": st.floats(0.1, 240),
}
bands = st.builds(
    lambda elevation, azimuth: Band(
        elevation_min_deg=elevation[0],
        elevation_max_deg=elevation[1],
        azimuth_min_deg=azimuth[0],
        azimuth_max_deg=azimuth[1],
    ),
    pairs,
    pairs,
)
tolerances = st.builds(Tolerance, pitch_deg=errors, roll_deg=errors, yaw_deg=errors)
constraints = st.builds(
    Constraints,
    overlap_h=fractions,
    overlap_v=fractions,
    band=bands,
    tolerance=tolerances,
    guarantee=guarantees,
    masks=masks,
    gimbal=st.none(),
    textured_below=st.none() | skylines,
)
specs = st.builds(
    PlanSpec,
    camera=cameras,
    constraints=st.builds(lambda base, gimbal: replace(base, gimbal=gimbal), constraints, limits),
    method=methods,
    order=orders,
    timing=st.builds(Timing, settle_s=st.floats(0, 5)),
    columns=st.none() | counts,
    rows=st.none() | counts,
)
options = st.fixed_dictionaries({}, optional=VALUES).map(lambda said: PlanOptions(**said))
files = st.builds(
    PlanFile,
    source=st.just("plan.json"),
    method=st.just("foreign"),
    camera=st.none() | cameras,
    constraints=st.none() | constraints,
    shots=st.just(published_plan("scenario-1-proposed").shots),
)

READ: dict[str, Callable[[PlanSpec], object]] = {
    "camera": lambda spec: spec.camera.with_lens("calibrated"),
    "lens": lambda spec: spec.camera.lens,
    "overlap_h": lambda spec: spec.constraints.overlap_h,
    "overlap_v": lambda spec: spec.constraints.overlap_v,
    "elevation_deg": lambda spec: (spec.constraints.band.elevation_min_deg, spec.constraints.band.elevation_max_deg),
    "azimuth_deg": lambda spec: (spec.constraints.band.azimuth_min_deg, spec.constraints.band.azimuth_max_deg),
    "tolerance_pitch_deg": lambda spec: spec.constraints.tolerance.pitch_deg,
    "tolerance_roll_deg": lambda spec: spec.constraints.tolerance.roll_deg,
    "tolerance_yaw_deg": lambda spec: spec.constraints.tolerance.yaw_deg,
    "guarantee": lambda spec: spec.constraints.guarantee,
    "masks": lambda spec: spec.constraints.masks,
    "textured_below": lambda spec: spec.constraints.textured_below,
    "gimbal": lambda spec: spec.constraints.gimbal,
    "method": lambda spec: spec.method,
    "order": lambda spec: spec.order,
    "columns": lambda spec: spec.columns,
    "rows": lambda spec: spec.rows,
    "budget_s": lambda spec: spec.budget_s,
}
"""Where in a specification each option ends; `overlap` is for the two that follow it."""


def test_every_option_is_tried_here() -> None:
    names = {field.name for field in fields(PlanOptions)}
    assert names == VALUES.keys() == READ.keys() | {"overlap"}


def expected(name: str, asked: PlanOptions, defaults: PlanSpec, file: PlanFile | None) -> object:
    """The rule, one option at a time: option, else file, else default."""
    said = getattr(asked, name)
    if said is None and name in ("overlap_h", "overlap_v"):
        said = asked.overlap
    if said is not None:
        return said
    if file is not None and name == "camera" and file.camera is not None:
        return file.camera
    of_constraints = name not in ("camera", "lens", "gimbal", "method", "order", "columns", "rows")
    if file is not None and file.constraints is not None and of_constraints:
        return READ[name](replace(defaults, constraints=file.constraints))
    return READ[name](defaults)


@given(asked=options, defaults=specs, file=st.none() | files)
def test_options_come_before_the_file_and_the_file_before_the_defaults(
    asked: PlanOptions, defaults: PlanSpec, file: PlanFile | None
) -> None:
    spec = asked.over(defaults, file)
    for name, value in READ.items():
        assert value(spec) == expected(name, asked, defaults, file), name
    assert spec.timing == defaults.timing
    if file is None:
        assert spec.given is None
    else:
        assert spec.given is not None
        assert (spec.given.camera, spec.given.constraints) == (spec.camera, spec.constraints)
        assert (spec.given.shots, spec.given.method) == (file.shots, file.method)


@given(defaults=specs)
def test_nothing_said_is_the_defaults(defaults: PlanSpec) -> None:
    assert PlanOptions().over(defaults) == defaults


@given(asked=options, defaults=specs, file=st.none() | files)
def test_saying_it_again_changes_nothing(asked: PlanOptions, defaults: PlanSpec, file: PlanFile | None) -> None:
    spec = asked.over(defaults, file)
    assert asked.over(spec, file) == spec
    assert asked.over(spec) == spec


def test_a_zero_is_said() -> None:
    defaults = configured_spec(Config(), configured_profile(Config()))
    spec = PlanOptions(overlap=0.0, tolerance_yaw_deg=0.0, masks=()).over(defaults)
    assert (spec.constraints.overlap_h, spec.constraints.overlap_v) == (0.0, 0.0)
    assert spec.constraints.tolerance.yaw_deg == 0.0


# --- the configuration


def config(**sections: Any) -> Config:
    return Config.model_validate({"vehicle": {"yaw_rate_deg_s": 30}} | sections)


def test_the_configuration_is_the_default() -> None:
    asked = config(
        mission={
            "overlap_h": 0.2,
            "overlap_v": 0.3,
            "elevation_deg": [-40, 20],
            "azimuth_deg": [170, 260],
            "guarantee": "all",
            "method": "paper",
            "order": "rows",
        },
        pointing={"tolerance_pitch_deg": 0.2, "tolerance_roll_deg": 0.3, "tolerance_yaw_deg": 1.5},
    )
    profile = load_profile("sony-a6000-35mm")
    assert configured_spec(asked, profile) == PlanSpec(
        camera=profile.camera,
        constraints=Constraints(
            overlap_h=0.2,
            overlap_v=0.3,
            band=Band(elevation_min_deg=-40, elevation_max_deg=20, azimuth_min_deg=170, azimuth_max_deg=260),
            tolerance=Tolerance(pitch_deg=0.2, roll_deg=0.3, yaw_deg=1.5),
            guarantee="all",
            gimbal=GimbalLimits(),
        ),
        method="paper",
        order="rows",
        timing=configured_timing(asked, profile),
    )


def test_timing_is_the_profile_s_unless_configured() -> None:
    profile = load_profile("sony-a6000-35mm")
    of_profile = configured_timing(config(camera={"latency_s": 0.4}), profile)
    assert of_profile == Timing(
        settle_s=0.3, exposure_s=profile.max_exposure_s, trigger_latency_s=0.4, interval_s=profile.min_interval_s
    )
    own = configured_timing(config(camera={"exposure_s": 0.5, "interval_s": 0}, pointing={"settle_s": 1}), profile)
    assert (own.settle_s, own.exposure_s, own.interval_s) == (1.0, 0.5, 0.0)


def test_by_default_the_vehicle_is_never_turned() -> None:
    assert configured_gimbal(config()).turning is None
    assert configured_gimbal(config(gimbal={"yaw_deg": [-160, 160]})).turning is None


def test_a_configured_pan_range_has_end_stops_unless_it_is_endless() -> None:
    assert configured_gimbal(config()).yaw_endless
    assert not configured_gimbal(config(gimbal={"yaw_deg": [-160, 160]})).yaw_endless
    assert configured_gimbal(config(gimbal={"yaw_deg": [-160, 160], "yaw_endless": True})).yaw_endless


def test_a_vehicle_that_pans_leaves_the_gimbal_no_pan_range() -> None:
    gimbal = configured_gimbal(config(gimbal={"yaw": "vehicle", "yaw_deg": [-160, 160], "pitch_deg": [-90, 20]}))
    assert (gimbal.yaw_min_deg, gimbal.yaw_max_deg, gimbal.yaw_endless, gimbal.pans) == (0.0, 0.0, False, False)
    assert gimbal.pitch_max_deg == 20
    assert gimbal.turning == Turning(rate_deg_s=30.0, acceleration_deg_s2=90.0)


def test_auto_keeps_the_configured_pan_range() -> None:
    gimbal = configured_gimbal(config(gimbal={"yaw": "auto", "yaw_deg": [-160, 160]}))
    assert (gimbal.yaw_min_deg, gimbal.yaw_max_deg, gimbal.all_round) == (-160.0, 160.0, True)


def test_the_calibrated_lens_is_refused_where_nothing_is_known_of_it() -> None:
    defaults = PlanSpec(camera=Camera.from_fov(60, 45, name="unknown"), constraints=PLAIN)
    with pytest.raises(UsageError, match="unknown has no calibrated lens: its profile has none of calibrated_focal"):
        PlanOptions(lens="calibrated").over(defaults)


def test_the_lens_applies_to_the_camera_of_a_plan_file_too() -> None:
    plan = published_plan("scenario-2-proposed")
    file = PlanFile(
        source="plan.json", method="foreign", camera=plan.camera, constraints=plan.constraints, shots=plan.shots
    )
    defaults = PlanSpec(camera=Camera.from_fov(60, 45), constraints=PLAIN)
    lenses: tuple[tuple[Lens, float], ...] = (("nominal", 45.0), ("calibrated", 46.0))
    for lens, focal_mm in lenses:
        spec = PlanOptions(lens=lens).over(defaults, file)
        assert spec.given is not None
        assert spec.given.camera.focal_length_used_mm == focal_mm
        assert spec.camera == spec.given.camera
    assert PlanOptions().over(defaults, file).camera == plan.camera
