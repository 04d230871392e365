"""docs/ground-station.md shows messages as they are."""

from __future__ import annotations

import json
import re

from panoexec.mqtt.messages import State, StateDelta
from panoexec.mqtt.parsing import parse_request
from panoexec.mqtt.state_deltas import StateFollower
from tests.repository import ROOT

TEXT = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")


def test_the_documented_state_is_one_and_the_delta_makes_another_of_it() -> None:
    document, delta = map(json.loads, re.findall(r"^```json\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL))
    follower = StateFollower()
    assert follower.whole(document) == document
    for one in (document, follower.delta(StateDelta.model_validate(delta).model_dump())):
        check(State.model_validate(one))


def check(state: State) -> None:
    counts = [int(piece[1:]) for piece in state.shots.split()]
    assert sum(counts) == state.shots_total
    done = [int(piece[1:]) for piece in state.shots.split() if piece[0] in "dr"]
    assert sum(done) == state.shots_done


def test_the_documented_request_is_accepted() -> None:
    ((command, payload),) = re.findall(r"/request/(\w+) \\\n +-m '(.*)'", TEXT)
    assert parse_request(command, payload.encode()).transaction == "a1"
