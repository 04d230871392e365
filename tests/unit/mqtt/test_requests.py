"""Requests from strangers: read strictly, refused with the field, never more than an error."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.errors import InputFileError
from panoexec.inputs.camera_profiles import profile_from_mapping
from panoexec.mqtt.messages import Response, dump, failed
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.requests import MAX_PAYLOAD, REQUESTS, PlanRequest, RefusedRequestError, SkipRequest
from panoexec.mqtt.topics import COMMANDS


def refused(command: str, payload: bytes | dict[str, Any], **options: Any) -> RefusedRequestError:
    raw = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    with pytest.raises(RefusedRequestError) as caught:
        parse_request(command, raw, **options)
    return caught.value


def test_reads_a_whole_request() -> None:
    request = parse_request(
        "start",
        b'{"transaction": 7, "camera": "dji-x5s-15mm", "overlap_h": 0.2, "elevation_deg": [-90, 30],'
        b' "azimuth_deg": [170, 190], "tolerance_deg": {"yaw": 0.5}, "reference": "heading"}',
    )
    assert isinstance(request, PlanRequest)
    assert request.command == "start"
    assert request.transaction == 7
    assert request.elevation_deg == [-90, 30]
    assert request.tolerance_deg is not None
    assert (request.tolerance_deg.yaw, request.tolerance_deg.pitch) == (0.5, None)


@pytest.mark.parametrize("command", sorted(set(REQUESTS) - {"set_profile"}))
def test_every_command_needs_no_more_than_a_transaction(command: str) -> None:
    assert parse_request(command, b'{"transaction": "a"}').command == command


@pytest.mark.parametrize(
    ("fields", "field", "says"),
    [
        ({"overlap": "0.2"}, "overlap", "valid number"),
        ({"overlap": True}, "overlap", "valid number"),
        ({"overlap": 1.0}, "overlap", "less than 1"),
        ({"overlap": -0.1}, "overlap", "0"),
        ({"overlaps": 0.2}, "overlaps", "not a known key"),
        ({"overlap": 0.2, "overlap_h": 0.2}, None, "exclude each other"),
        ({"elevation_deg": [30, -90]}, "elevation_deg", "min < max"),
        ({"elevation_deg": [-91, 0]}, "elevation_deg", "-90"),
        ({"elevation_deg": [-90]}, "elevation_deg", "2 items"),
        ({"elevation_deg": 5}, "elevation_deg", "list"),
        ({"azimuth_deg": [0, 361]}, "azimuth_deg", "360"),
        ({"tolerance_deg": {"yaw": -1}}, "tolerance_deg.yaw", "0"),
        ({"tolerance_deg": {"jaw": 1}}, "tolerance_deg.jaw", "not a known key"),
        ({"camera": 5}, "camera", "name of a camera profile"),
        ({"camera": "../../etc/passwd"}, "camera", "name of a camera profile"),
        ({"camera": "secret.toml"}, "camera", "name of a camera profile"),
        ({"reference": "south"}, "reference", "north"),
        ({"plan": []}, "plan", "dictionary"),
        ({"plan": {}, "method": "paper"}, None, "omit method"),
        ({"transaction": ""}, "transaction", "1 to 128"),
        ({"transaction": None}, "transaction", "1 to 128"),
        ({"transaction": True}, "transaction", "1 to 128"),
        ({"transaction": 1.5}, "transaction", "1 to 128"),
        ({"transaction": "x" * 129}, "transaction", "1 to 128"),
        ({"transaction": 10**30}, "transaction", "1 to 128"),
    ],
)
def test_names_the_field_that_is_wrong(fields: dict[str, Any], field: str | None, says: str) -> None:
    error = refused("plan", {"transaction": "t"} | fields)
    assert (error.code, error.field) == ("invalid", field)
    assert says in error.message
    assert error.transaction == ("t" if "transaction" not in fields else None)


def test_a_request_without_a_transaction_is_answered_without_one() -> None:
    error = refused("get", {})
    assert (error.code, error.field, error.transaction) == ("invalid", "transaction", None)


@pytest.mark.parametrize("shot", [-1, 1.0, "3", True, 10**9])
def test_a_shot_is_an_index(shot: object) -> None:
    assert refused("skip", {"transaction": 1, "shot": shot}).field == "shot"
    parsed = parse_request("skip", b'{"transaction": 1, "shot": 3}')
    assert isinstance(parsed, SkipRequest)
    assert parsed.shot == 3


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"start",
        b"[]",
        b"null",
        b'"x"',
        b'{"transaction": 1',
        b'\xff\xfe{"transaction": 1}',
        b'{"transaction": 1, "overlap": NaN}',
        b'{"transaction": 1, "overlap": -Infinity}',
        b'{"transaction": 1, "transaction": 2}',
        b'{"transaction": 1, "plan": ' + b"[" * 20_000 + b"]" * 20_000 + b"}",
        b'{"transaction": ' + b"9" * 20_000 + b"}",
    ],
)
def test_what_is_no_json_object_is_said_to_be_none(payload: bytes) -> None:
    assert refused("plan", payload).code == "not_json"


def test_infinity_written_as_a_huge_number_is_refused() -> None:
    assert refused("plan", b'{"transaction": 1, "overlap": 1e999}').field == "overlap"


def test_size_is_judged_before_anything_is_read() -> None:
    body = b'{"transaction": 1, "reason": "' + b"x" * MAX_PAYLOAD + b'"}'
    assert refused("pause", body).code == "too_large"
    assert refused("pause", b"", size=70_000).code == "too_large"
    filler = MAX_PAYLOAD - len(b'{"transaction": 1}')
    assert parse_request("pause", b'{"transaction": 1' + b" " * filler + b"}").transaction == 1


def test_unknown_commands_and_retained_requests_are_refused_with_their_transaction() -> None:
    error = refused("fly", {"transaction": "t"})
    assert (error.code, error.transaction) == ("unknown_command", "t")
    assert "start" in error.message
    error = refused("start", {"transaction": "t"}, retained=True)
    assert (error.code, error.transaction) == ("retained", "t")


def test_an_answer_can_echo_whatever_was_sent() -> None:
    error = refused("fly", b'{"transaction": "\\ud800"}')
    document = json.loads(dump(failed(error)))
    assert document["transaction"] == "\ud800"
    assert document["status"] == "error"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=12,
)
KEYS = sorted({name for model in REQUESTS.values() for name in model.model_fields})


@settings(max_examples=200, deadline=None)
@given(
    command=st.sampled_from(sorted(REQUESTS)) | st.text(max_size=10),
    document=st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=10), JSON, max_size=6) | JSON,
    retained=st.booleans(),
)
def test_any_json_is_a_request_or_an_error_that_can_be_sent(command: str, document: object, retained: bool) -> None:
    try:
        request = parse_request(command, json.dumps(document).encode(), retained=retained)
    except RefusedRequestError as error:
        Response.model_validate(json.loads(dump(failed(error))))
    else:
        assert not retained
        assert request.command == command


@settings(max_examples=200, deadline=None)
@given(payload=st.binary(max_size=200), data=st.data())
def test_any_bytes_are_a_request_or_an_error_that_can_be_sent(payload: bytes, data: st.DataObject) -> None:
    whole = b'{"transaction": "t", "camera": {"name": "x"}, "overlap": 0.2, "elevation_deg": [-90, 30]}'
    at = data.draw(st.integers(0, len(whole)))
    for raw in (payload, whole[:at] + payload[:3] + whole[at:], whole[:at] + payload[:3] + whole[at + 3 :]):
        try:
            parse_request("start", raw)
        except RefusedRequestError as error:
            answer = Response.model_validate(json.loads(dump(failed(error))))
            assert answer.status == "error"
            assert answer.error is not None
            assert answer.error.message


def test_the_names_of_the_commands_are_listed_once_for_all() -> None:
    assert set(REQUESTS) == set(COMMANDS)


def test_a_large_request_that_is_wrong_everywhere_is_refused_at_once() -> None:
    """A key that comes twice behind 7700 others took seconds, in which the daemon obeyed no stop."""
    keys = [f'"{number:x}":0' for number in range(7700)]
    requests = {
        "one key twice": "{" + ",".join([*keys, keys[-1]]) + "}",
        "unknown keys": "{" + ",".join(keys) + "}",
        "wrong values": '{"transaction":1,"shots":[' + ",".join(['"a"'] * 9900) + "]}",
    }
    for what, payload in requests.items():
        began_s = time.process_time()
        error = refused("thumbnails", payload.encode())
        assert time.process_time() - began_s < 0.5, what
        assert len(error.message) < 1000


def test_of_many_problems_some_are_told_and_how_many_more_there_are() -> None:
    with pytest.raises(InputFileError) as caught:
        profile_from_mapping({f"key{number}": 0 for number in range(7000)}, source="camera")
    assert len(caught.value.problems) < 60
    assert any(line.startswith("and ") and line.endswith(" more problems") for line in caught.value.problems)
