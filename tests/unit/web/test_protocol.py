"""Messages of browsers: what makes sense is taken, all else is refused with a reason."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.mqtt.requests import REQUESTS
from panoexec.web import protocol
from panoexec.web.protocol import Command, Follow, Name, RefusedMessageError, from_browser

COMMAND = {"type": "command", "id": "a" * 8, "vehicle": "drone", "command": "pause", "fields": {"reason": "wind"}}


def test_messages_are_read() -> None:
    assert from_browser('{"type": "follow", "vehicle": "drone"}') == Follow(vehicle="drone")
    assert from_browser('{"type": "follow"}') == Follow(vehicle=None)
    assert from_browser('{"type": "name", "name": " TABLET\\n2 "}') == Name(name="TABLET 2")
    command = from_browser(json.dumps(COMMAND))
    assert command == Command(id="a" * 8, vehicle="drone", command="pause", fields={"reason": "wind"})


def test_the_commands_are_those_of_the_interface() -> None:
    assert set(protocol.COMMANDS) == set(REQUESTS)
    assert {name for name, model in REQUESTS.items() if not model.acts} - {"doctor"} == protocol.VIEWER_COMMANDS


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"id": "short"}, "id"),
        ({"id": "a b c d e f"}, "id"),
        ({"vehicle": "../drone"}, "vehicle"),
        ({"vehicle": "+"}, "vehicle"),
        ({"command": "arm"}, "command"),
        ({"command": ["pause"]}, "command"),
        ({"fields": []}, "fields"),
        ({"fields": {"transaction": "mine"}}, "transaction"),
        ({"type": "obey"}, "type"),
    ],
)
def test_a_wrong_field_is_named(change: dict[str, Any], told: str) -> None:
    with pytest.raises(RefusedMessageError, match=told):
        from_browser(json.dumps(COMMAND | change))


def test_deep_nesting_is_refused() -> None:
    deep: Any = 1
    for _ in range(40):
        deep = [deep]
    with pytest.raises(RefusedMessageError, match="deeply"):
        from_browser(json.dumps(COMMAND | {"fields": {"plan": deep}}))
    with pytest.raises(RefusedMessageError):
        from_browser("[" * 30_000)


@given(st.text() | st.binary().map(lambda raw: raw.decode("latin1")))
def test_noise_is_refused(noise: str) -> None:
    try:
        from_browser(noise)
    except RefusedMessageError:
        return
    raise AssertionError(noise)
