"""What the daemon answers is what the models of the answers say."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from pydantic import ValidationError

from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.plan_file import camera_to_data, certificate_to_data, estimate_to_data, plan_to_data
from panoexec.mqtt.answers import ANSWERS, CameraFields, PlanFields, planned
from panoexec.mqtt.requests import REQUESTS, STOPPING
from panoexec.planning.make_plan import make_plan
from panoexec.planning.model import Band, Certificate, Constraints, Hole, Plan, Timing, Tolerance
from tests.schemas import misfits, named, problems

CAMERA = load_profile("dji-x5s-15mm").camera
CONSTRAINTS = Constraints(
    overlap_h=0.15,
    overlap_v=0.15,
    band=Band(elevation_min_deg=-20.0, elevation_max_deg=20.0, azimuth_min_deg=0.0, azimuth_max_deg=90.0),
    tolerance=Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7),
)
FAILED = Certificate(
    certified=False,
    images=2,
    min_overlap_h=None,
    min_overlap_v=0.1,
    worst_overlap_h=None,
    worst_overlap_v=0.1,
    uncovered_fraction=0.25,
    connected=True,
    two_edge_connected=False,
    failures=("C1: a hole",),
    holes=(Hole(elevation_deg=1.0, azimuth_deg=2.0, size_deg=3.0),),
    weakest_h=(0, 1),
    bridges=((0, 1),),
)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(CAMERA, CONSTRAINTS, method="certified", timing=Timing(), order="rows")


def test_every_command_has_an_answer() -> None:
    assert ANSWERS.keys() == REQUESTS.keys()


def test_a_plan_is_answered_as_its_file_describes_it(plan: Plan) -> None:
    for one in (plan, replace(plan, certificate=FAILED), replace(plan, certificate=None, estimate=None)):
        data = planned(one, hover_s=1200.0, shots=False)
        needed = None if one.estimate is None else round(one.estimate.duration_s / 1200.0, 4)
        assert planned(one, hover_s=0.0, shots=False) == data | {"battery_need_frac": None}
        assert planned(one, hover_s=1200.0, shots=True) == data | {"plan": plan_to_data(one)}
        assert data == {
            "images": len(one.shots),
            "rows": len({shot.row for shot in one.shots}),
            "duration_s": None if one.estimate is None else one.estimate.duration_s,
            "estimate": None if one.estimate is None else estimate_to_data(one.estimate),
            "certificate": None if one.certificate is None else certificate_to_data(one.certificate),
            "camera": camera_to_data(one.camera),
            "lower_bound": one.lower_bound,
            "notes": list(one.notes),
            "battery_need_frac": needed,
        }
        answer = {"transaction": 1, "status": "ok", "error": None, "data": data}
        assert misfits("response_plan", answer) == []
        drawn = json.loads(json.dumps(planned(one, hover_s=1200.0, shots=True)))
        assert misfits("response_plan", answer | {"data": drawn}) == []
        assert misfits("response_start", answer | {"data": {"mission_id": "m"} | data}) == []
        assert misfits("response_start", answer), "which mission must be there"


def test_a_plan_file_fits_its_model(plan: Plan) -> None:
    document = json.loads(json.dumps(plan_to_data(plan)))
    assert problems(document, named("Plan")) == []
    PlanFields.model_validate(document)
    for key in document:
        with pytest.raises(ValidationError):
            PlanFields.model_validate({name: value for name, value in document.items() if name != key})


def test_only_a_calibrated_camera_says_so() -> None:
    plain = camera_to_data(replace(CAMERA, calibrated_focal_length_mm=None))
    assert CameraFields(**plain).model_dump(exclude_unset=True) == plain
    assert problems(plain, named("Camera")) == []
    assert problems(plain | {"calibrated_focal_length_mm": None}, named("Camera"))
    assert CAMERA.calibrated_focal_length_mm is not None
    assert problems(camera_to_data(CAMERA), named("Camera")) == []


@pytest.mark.parametrize("command", ["pause", "finish", "resume", "abort", "skip", "repeat"])
def test_answers_of_a_mission_under_way(command: str) -> None:
    shot = {"shot": 3} if command in {"skip", "repeat"} else {}
    durable = {"durable": True} if command in STOPPING else {}
    data = shot | {"mission_id": "m", "state": "capturing"} | durable
    answer = {"transaction": "t", "status": "ok", "error": None, "data": data}
    assert misfits(f"response_{command}", answer) == []
    ANSWERS[command].model_validate(data)
    without_state = answer | {"data": {key: value for key, value in data.items() if key != "state"}}
    assert bool(misfits(f"response_{command}", without_state)) == (command not in {"resume", "abort"})
