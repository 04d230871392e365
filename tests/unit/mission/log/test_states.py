"""The transition table, pair by pair."""

from __future__ import annotations

import itertools
import re

import pytest

from panoexec.mission.log.states import (
    ENDED,
    FINISHED,
    TRANSITIONS,
    IllegalTransitionError,
    MissionState,
    check_transition,
)
from tests.repository import ROOT

S = MissionState

LEGAL = {
    ("idle", "preflight"),
    ("preflight", "capturing"),
    ("preflight", "paused"),
    ("preflight", "finishing"),
    ("preflight", "aborted"),
    ("preflight", "failed"),
    ("capturing", "paused"),
    ("capturing", "finishing"),
    ("capturing", "aborted"),
    ("capturing", "failed"),
    ("paused", "capturing"),
    ("paused", "finishing"),
    ("paused", "aborted"),
    ("paused", "failed"),
    ("finishing", "capturing"),
    ("finishing", "paused"),
    ("finishing", "complete"),
    ("finishing", "incomplete"),
    ("finishing", "aborted"),
    ("finishing", "failed"),
    ("complete", "idle"),
    ("incomplete", "idle"),
    ("aborted", "idle"),
    ("failed", "idle"),
}


@pytest.mark.parametrize(("old", "new"), list(itertools.product(S, S)))
def test_every_pair(old: S, new: S) -> None:
    if (old.value, new.value) in LEGAL:
        check_transition(old, new)
    else:
        with pytest.raises(IllegalTransitionError, match=f"from {old} to {new}"):
            check_transition(old, new)


def test_the_contracts_states_and_no_others() -> None:
    names = ["idle", "preflight", "capturing", "paused", "finishing", "complete", "incomplete", "aborted", "failed"]
    assert [state.value for state in S] == names
    assert set(TRANSITIONS) == set(S)


def test_an_end_can_be_reached_from_everywhere_and_only_failed_missions_among_the_ended_can_be_resumed() -> None:
    assert ENDED - {S.FAILED} == FINISHED
    for start in S:
        seen, front = {start}, [start]
        while front:
            front = [new for old in front for new in TRANSITIONS[old] if new not in seen]
            seen.update(front)
        assert seen & {S.ABORTED, S.FAILED}


def test_the_documentation_lists_the_same_transitions() -> None:
    text = (ROOT / "docs" / "mission.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]*) \|", text, flags=re.MULTILINE)
    listed = {(old, new) for old, cell in rows if old in set(S) for new in re.findall(r"`(\w+)`", cell)}
    assert listed == LEGAL
