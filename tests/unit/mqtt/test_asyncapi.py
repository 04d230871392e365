"""The document in the repository is what the code says, and what the code sends is what the document says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from panoexec.devices import EvidenceLevel
from panoexec.events import EVENT_TYPES, MissionFinished, MissionStarted, Photo, ShotAccepted
from panoexec.mqtt.asyncapi import document, text
from panoexec.mqtt.messages import REQUESTS, RefusedRequestError, failed, ok
from panoexec.states import MissionState

FILE = Path(__file__).parents[3] / "asyncapi.yaml"
DOCUMENT = document()


def problems(value: Any, schema: dict[str, Any], where: str = "$") -> list[str]:
    """What of JSON Schema the document uses, and nothing else: an unknown keyword is a problem."""
    known = {"description", "default", "format", "type", "enum", "const", "anyOf", "oneOf", "$ref", "properties"}
    known |= {"required", "additionalProperties", "items", "minItems", "maxItems", "minimum", "maximum"}
    known |= {"exclusiveMaximum", "exclusiveMinimum", "minLength", "maxLength"}
    out = [f"{where}: keyword {key}" for key in set(schema) - known]
    if "$ref" in schema:
        return out + problems(value, DOCUMENT["components"]["schemas"][schema["$ref"].rpartition("/")[2]], where)
    for key in ("anyOf", "oneOf"):
        if key in schema:
            fits = sum(not problems(value, one, where) for one in schema[key])
            if fits == 0 or (key == "oneOf" and fits > 1):
                out.append(f"{where}: fits {fits} of {key}")
    if "const" in schema and value != schema["const"]:
        out.append(f"{where}: {value!r} is not {schema['const']!r}")
    if "enum" in schema and value not in schema["enum"]:
        out.append(f"{where}: {value!r} is none of {schema['enum']}")
    return out + of_type(value, schema, where)


def of_type(value: Any, schema: dict[str, Any], where: str) -> list[str]:
    kinds = {"string": str, "integer": int, "object": dict, "array": list, "boolean": bool, "null": type(None)}
    names = schema.get("type", [])
    names = [names] if isinstance(names, str) else names
    if names and not any(
        isinstance(value, (int, float) if name == "number" else kinds[name])
        and (name == "boolean" or not isinstance(value, bool))
        for name in names
    ):
        return [f"{where}: {value!r} is no {names}"]
    out = []
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        out += [f"{where}: {name} is missing" for name in schema.get("required", []) if name not in value]
        if schema.get("additionalProperties") is False:
            out += [f"{where}: {name} is too much" for name in set(value) - set(properties)]
        for name in set(value) & set(properties):
            out += problems(value[name], properties[name], f"{where}.{name}")
    if isinstance(value, list) and "items" in schema:
        for number, item in enumerate(value):
            out += problems(item, schema["items"], f"{where}[{number}]")
    return out


def named(name: str) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{name}"}


def test_the_file_in_the_repository_is_what_the_code_says() -> None:
    assert FILE.read_text(encoding="utf-8") == text(), "run: python -m panoexec.mqtt.asyncapi asyncapi.yaml"


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


@pytest.mark.parametrize("answer", [ok(1, {"x": 1}), failed(RefusedRequestError("busy", "m"), "t")])
def test_answers_fit(answer: Any) -> None:
    assert problems(answer.model_dump(mode="json"), named("Response")) == []
    assert problems(answer.model_dump(mode="json") | {"status": "maybe"}, named("Response"))


def test_requests_fit_and_wrong_ones_do_not() -> None:
    good = {"transaction": "t", "camera": "dji-x5s-15mm", "overlap": 0.2, "tolerance_deg": {"yaw": 1.0}}
    assert problems(good, named("StartRequest")) == []
    for wrong in ({"overlap": "x"}, {"jaw": 1}, {"reference": "south"}, {"transaction": None}):
        assert problems(good | wrong, named("StartRequest")), wrong
