"""The embedded autopilot says to its gimbal what the real one said (tests/data, ArduCopter 4.7.0-dev SITL)."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import pytest

from panoexec.sim.config import SimConfig
from tests.repository import ROOT
from tests.wire.gimbal_conversation import ASKED, EmbeddedGround, hold

DATA = ROOT / "tests" / "data" / "arducopter-to-gimbal.jsonl"
RATES = ("target_per_s", "state_per_s")


@cache
def recorded() -> dict[str, dict[str, Any]]:
    lines = DATA.read_text(encoding="utf-8").splitlines()
    return {step["step"]: step for step in map(json.loads, lines)}


@cache
def said() -> dict[str, dict[str, Any]]:
    ground = EmbeddedGround(SimConfig())
    # through JSON: tuples are lists there
    return {step["step"]: json.loads(json.dumps(step)) for step in hold(ground, ground.at_gimbal)}


def test_the_recording_is_of_the_same_conversation() -> None:
    assert list(said()) == list(recorded()) == [step for step, _ in ASKED]


@pytest.mark.parametrize("step", [step for step, _ in ASKED])
def test_says_to_the_gimbal_what_the_real_autopilot_said(step: str) -> None:
    ours, real = dict(said()[step]), dict(recorded()[step])
    for rate in RATES:
        # the recording was made in real time, so a message may have come on the other side of a second's end
        assert ours.pop(rate) == pytest.approx(real.pop(rate), rel=0.15)
    assert ours == real
