"""The embedded vehicle flies a mission with held waypoints as recorded autopilots did (tests/data)."""

from __future__ import annotations

import json
from functools import cache
from typing import Any, TypeAlias

import pytest

from panoexec.sim.config import AirframeConfig, SimConfig
from tests.repository import ROOT
from tests.wire.mission_conversation import LATITUDE, LONGITUDE, hold
from tests.wire.sim_peer import EmbeddedPeer

Steps: TypeAlias = dict[str, dict[str, Any]]

FILES = {"ardupilot": "arducopter-mission", "px4": "px4-mission"}
STANDS = AirframeConfig(
    in_air=False, latitude_deg=LATITUDE, longitude_deg=LONGITUDE, height_m=15.0, home_altitude_m=488.0, wind_m_s=0.0
)
HELD = "the hold ends"
"""The step whose duration is the autopilot's hold time and not a matter of how fast it flies."""


@cache
def recorded(kind: str) -> Steps:
    lines = (ROOT / "tests" / "data" / f"{FILES[kind]}.jsonl").read_text(encoding="utf-8").splitlines()
    return {step["step"]: step for step in map(json.loads, lines)}


@cache
def said(kind: str) -> Steps:
    peer = EmbeddedPeer(SimConfig(autopilot=kind, airframe=STANDS))  # type: ignore[arg-type]
    return {step["step"]: step for step in hold(peer, kind)}


def told(step: dict[str, Any]) -> dict[str, Any]:
    """Without the time that flying takes; PX4 tells the reached and the current item at one moment, in any order."""
    fields = {name: value for name, value in step.items() if name != "took_s"}
    return fields | ({"told": sorted(fields["told"], key=str)} if "told" in fields else {})


@pytest.mark.parametrize("kind", FILES)
def test_the_recording_is_of_the_same_flight(kind: str) -> None:
    assert list(said(kind)) == list(recorded(kind))
    assert len(recorded(kind)) >= 15


@pytest.mark.parametrize(("kind", "step"), [(kind, step) for kind in FILES for step in recorded(kind)])
def test_flies_as_the_real_autopilot_did(kind: str, step: str) -> None:
    assert told(said(kind)[step]) == told(recorded(kind)[step])


@pytest.mark.parametrize("kind", FILES)
def test_the_hold_time_is_that_of_the_real_autopilot(kind: str) -> None:
    assert said(kind)[HELD]["took_s"] == pytest.approx(recorded(kind)[HELD]["took_s"], abs=1.0)
