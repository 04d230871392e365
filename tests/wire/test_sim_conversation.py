"""The embedded vehicle answers as the real ArduCopter answered (tests/data, ArduCopter 4.7.0-dev SITL)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from tests.wire.conversation import hold
from tests.wire.sim_peer import EmbeddedPeer

Steps: TypeAlias = dict[str, dict[str, Any]]

RECORDED = Path(__file__).parents[1] / "data" / "arducopter-conversation.jsonl"


@pytest.fixture(scope="module")
def said() -> Steps:
    """What the embedded vehicle says at each step."""
    return {step["step"]: step for step in hold(EmbeddedPeer())}


@pytest.fixture(scope="module")
def recorded() -> Steps:
    lines = RECORDED.read_text(encoding="utf-8").splitlines()
    return {step["step"]: step for step in map(json.loads, lines)}


def _steps() -> list[str]:
    return [json.loads(line)["step"] for line in RECORDED.read_text(encoding="utf-8").splitlines()]


def test_the_recording_is_of_the_same_conversation(said: Steps, recorded: Steps) -> None:
    assert list(said) == list(recorded)
    assert len(recorded) > 30


@pytest.mark.parametrize("step", _steps())
def test_answers_as_the_real_autopilot_did(step: str, said: Steps, recorded: Steps) -> None:
    assert said[step] == recorded[step]
