"""The embedded vehicle responds like a recorded ArduCopter (tests/data, ArduCopter 4.7.0-dev SITL)."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from typing import Any, TypeAlias

import pytest

from panoexec.sim.config import AirframeConfig, GimbalConfig, SimConfig
from tests.repository import ROOT
from tests.wire.conversation import ASKED, ASKED_SERVO, hold
from tests.wire.sim_peer import EmbeddedPeer

Steps: TypeAlias = dict[str, dict[str, Any]]

DATA = ROOT / "tests" / "data"
LIMITED = dataclasses.replace(GimbalConfig(), pitch=dataclasses.replace(GimbalConfig().pitch, max_deg=45.0))
STANDS = AirframeConfig(in_air=False)
VEHICLES = {
    "arducopter-conversation": (ASKED, SimConfig(airframe=STANDS)),
    "arducopter-conversation-servo": (
        ASKED_SERVO,
        SimConfig(mount="servo", camera_kind="servo", gimbal=LIMITED, airframe=STANDS),
    ),
}


@cache
def recorded(name: str) -> Steps:
    """What the real autopilot said at each step."""
    lines = (DATA / f"{name}.jsonl").read_text(encoding="utf-8").splitlines()
    return {step["step"]: step for step in map(json.loads, lines)}


@cache
def said(name: str) -> Steps:
    """What the embedded vehicle says at each step."""
    asked, config = VEHICLES[name]
    return {step["step"]: step for step in hold(EmbeddedPeer(config), asked)}


@pytest.mark.parametrize("name", VEHICLES)
def test_the_recording_is_of_the_same_conversation(name: str) -> None:
    assert list(said(name)) == list(recorded(name))
    assert len(recorded(name)) >= len(VEHICLES[name][0]) + 2


@pytest.mark.parametrize(("name", "step"), [(name, step) for name in VEHICLES for step in recorded(name)])
def test_answers_as_the_real_autopilot_did(name: str, step: str) -> None:
    assert said(name)[step] == recorded(name)[step]
