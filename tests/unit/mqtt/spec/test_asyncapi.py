"""The document in the repository is what the code says, and what the code sends is what the document says."""

from __future__ import annotations

import json
from typing import Any

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.inputs.camera_profiles import load_profile
from panoexec.inputs.plan_file import camera_to_data
from panoexec.mission.log.events import EVENT_TYPES, MissionFinished, MissionStarted, Photo, ShotAccepted
from panoexec.mission.log.states import MissionState
from panoexec.mqtt.messages import failed, ok
from panoexec.mqtt.requests import REQUESTS, RefusedRequestError
from panoexec.mqtt.spec.asyncapi import text
from tests.repository import ROOT
from tests.schemas import DOCUMENT, misfits, named, problems

CAMERA = camera_to_data(load_profile("dji-x5s-15mm").camera)
FILE = ROOT / "asyncapi.yaml"


def test_the_file_in_the_repository_is_what_the_code_says() -> None:
    assert FILE.read_text(encoding="utf-8") == text(), "run: python -m panoexec.mqtt.spec.asyncapi asyncapi.yaml"


def references(value: Any) -> list[str]:
    if isinstance(value, dict):
        return [v for k, v in value.items() if k == "$ref"] + [r for v in value.values() for r in references(v)]
    return [r for item in value for r in references(item)] if isinstance(value, list) else []


def test_every_reference_leads_somewhere() -> None:
    found = references(DOCUMENT)
    assert len(found) > 50
    for reference in found:
        at: Any = DOCUMENT
        for part in reference.removeprefix("#/").split("/"):
            at = at[part]


def test_every_command_and_every_event_is_described() -> None:
    assert {f"request_{command}" for command in REQUESTS} <= DOCUMENT["channels"].keys()
    assert all(DOCUMENT["operations"][command]["reply"] for command in REQUESTS)
    kinds = {one["$ref"].rpartition("/")[2] for one in DOCUMENT["components"]["schemas"]["Event"]["oneOf"]}
    assert len(kinds) == len(EVENT_TYPES) > 15


def test_events_fit_and_wrong_ones_do_not() -> None:
    photo = Photo(number=1, evidence=EvidenceLevel.COUNTED, capture_time_utc_s=1.0)
    for event in (
        MissionStarted(mission_id="m", seq=1, shots_total=3),
        ShotAccepted(mission_id="m", seq=2, state=MissionState.CAPTURING, shot=0, attempt=1, photos=(photo,)),
        MissionFinished(mission_id="m", seq=3, reason="r", accepted=1, missing=(2,), certified=None),
    ):
        sent = json.loads(json.dumps(event.to_json()))
        assert problems(sent, named("Event")) == []
        for key in sent:
            assert problems({k: v for k, v in sent.items() if k != key}, named("Event")), f"{key} must be there"


@pytest.mark.parametrize("answer", [ok(1, {"camera": CAMERA}), failed(RefusedRequestError("busy", "m"), "t")])
def test_answers_fit(answer: Any) -> None:
    assert misfits("response_set_profile", answer.model_dump(mode="json")) == []
    assert misfits("response_set_profile", answer.model_dump(mode="json") | {"status": "maybe"})
    assert misfits("response_set_profile", answer.model_dump(mode="json") | {"data": {"x": 1}})


def test_requests_fit_and_wrong_ones_do_not() -> None:
    good = {"transaction": "t", "camera": "dji-x5s-15mm", "overlap": 0.2, "tolerance_deg": {"yaw": 1.0}}
    assert problems(good, named("StartRequest")) == []
    for wrong in ({"overlap": "x"}, {"jaw": 1}, {"reference": "south"}, {"transaction": None}):
        assert problems(good | wrong, named("StartRequest")), wrong
