"""Events survive the way to JSON and back, whatever is in them."""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoexec.devices import EvidenceLevel
from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState

FLOATS = st.floats(allow_nan=True, allow_infinity=False, width=32)


def _values(hint: Any) -> st.SearchStrategy[Any]:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        if args[-1] is Ellipsis:
            return st.lists(_values(args[0]), max_size=3).map(tuple)
        return st.tuples(*(_values(arg) for arg in args))
    if origin is not None:  # X | None: where None says "unknown", a number is a number
        known = next(arg for arg in args if arg is not type(None))
        return st.none() | (st.floats(allow_nan=False, allow_infinity=False) if known is float else _values(known))
    if hint is float:
        return FLOATS
    if hint is str:
        return st.text(max_size=8)
    if hint is int:
        return st.integers(0, 10**6)
    if hint is bool:
        return st.booleans()
    if hint in {EvidenceLevel, MissionState}:
        return st.sampled_from(list(hint))
    return _instances(hint)


def _instances(cls: type[Any]) -> st.SearchStrategy[Any]:
    hints = typing.get_type_hints(cls)
    fields = {f.name: _values(hints[f.name]) for f in dataclasses.fields(cls)}
    if "time_utc_s" in fields:
        fields["time_utc_s"] = st.floats(0, 4e9)
    return st.builds(cls, **fields)


def _same(a: Any, b: Any) -> bool:
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(_same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float):
        return isinstance(b, float) and (a == b or (math.isnan(a) and math.isnan(b)))
    return bool(a == b and type(a) is type(b))


@pytest.mark.parametrize("kind", sorted(ev.EVENT_TYPES))
@settings(max_examples=40)
@given(data=st.data())
def test_round_trip_through_text(kind: str, data: st.DataObject) -> None:
    event = data.draw(_instances(ev.EVENT_TYPES[kind]))
    text = json.dumps(event.to_json(), allow_nan=False)
    assert _same(event, ev.event_from_json(json.loads(text)))


def test_types_are_named_as_in_the_contract() -> None:
    named = {"mission_started", "shot_accepted", "shot_rejected", "shot_retaken", "mission_paused"}
    assert named <= set(ev.EVENT_TYPES)
    assert all(ev.EVENT_TYPES[name].type == name for name in ev.EVENT_TYPES)
    assert ev.EVENT_TYPES["shot_accepted"] is ev.ShotAccepted


def test_an_id_tells_repeats_and_the_stamp_is_utc() -> None:
    event = ev.ShotSkipped(mission_id="m", seq=7, time_utc_s=1_700_000_000.25, shot=3, attempt=1)
    document = event.to_json()
    assert (document["id"], document["time"]) == ("m/7", "2023-11-14T22:13:20.250Z")


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"type": "shot_exploded"},
        {"type": "event"},
        {"type": "shot_event", "shot": 1, "attempt": 1},
        {"type": "shot_skipped", "shot": 1},
        {"type": "shot_skipped", "shot": "one", "attempt": 1},
        {"type": "shot_skipped", "shot": 1, "attempt": 1, "state": "flying"},
        {"type": "shot_accepted", "shot": 1, "attempt": 1, "photos": [{"number": 1, "evidence": "sworn"}]},
    ],
)
def test_what_does_not_fit_is_refused(document: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"."):
        ev.event_from_json(document)
