"""The embedded PX4's gimbal manager answers as the real one did (tests/data, PX4 1.17.0-alpha SIH)."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from tests.repository import ROOT
from tests.wire.px4_conversation import embedded, embedded_aux, hold, hold_aux, hold_in_air
from tests.wire.sim_peer import EmbeddedPeer

DATA = ROOT / "tests" / "data"


def _lines(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (DATA / name).read_text(encoding="utf-8").splitlines()]


LINES = _lines("px4-conversation.jsonl")
AUX = _lines("px4-aux-conversation.jsonl")
RECORDED = {line["step"]: line for line in LINES}


@cache
def said() -> dict[str, dict[str, Any]]:
    steps = [*hold(EmbeddedPeer(embedded())), *hold_in_air(EmbeddedPeer(SimConfig(autopilot="px4")))]
    # through JSON: tuples are lists there
    return {step["step"]: json.loads(json.dumps(step)) for step in steps}


def test_the_recording_is_of_the_same_conversation() -> None:
    assert list(said()) == list(RECORDED)
    assert len(RECORDED) == len(LINES) >= 25


@pytest.mark.parametrize("step", RECORDED)
def test_answers_as_px4_did(step: str) -> None:
    assert said()[step] == RECORDED[step]


def test_a_gimbal_on_outputs_is_echoed_as_px4_does() -> None:
    """Its attitude is the demanded one at once: nobody measures it."""
    assert [json.loads(json.dumps(step)) for step in hold_aux(EmbeddedPeer(embedded_aux()))] == AUX
    angles = [step for step in AUX if step["step"].startswith("angles")]
    assert [step["pitch_deg"] for step in angles] == [-30, 10, -60]
    assert not any(step["turning"] for step in angles)
