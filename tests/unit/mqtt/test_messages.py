"""docs/ground-station.md shows messages as they are."""

from __future__ import annotations

import re

from panoexec.mqtt.messages import State
from panoexec.mqtt.parsing import parse_request
from tests.repository import ROOT

TEXT = (ROOT / "docs" / "ground-station.md").read_text(encoding="utf-8")


def test_the_documented_state_is_one() -> None:
    (document,) = re.findall(r"^```json\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    state = State.model_validate_json(document)
    counts = [int(piece[1:]) for piece in state.shots.split()]
    assert sum(counts) == state.shots_total
    done = [int(piece[1:]) for piece in state.shots.split() if piece[0] in "dr"]
    assert sum(done) == state.shots_done


def test_the_documented_request_is_accepted() -> None:
    ((command, payload),) = re.findall(r"/request/(\w+) \\\n +-m '(.*)'", TEXT)
    assert parse_request(command, payload.encode()).transaction == "a1"
