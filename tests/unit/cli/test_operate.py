"""What the operator's verbs say of an answer."""

from __future__ import annotations

import argparse

import pytest

from panoexec.cli.operate import VERBS


@pytest.mark.parametrize(
    ("verb", "state", "says"),
    [
        ("pause", "capturing", "kite: mission M pauses after the current photo (it is capturing)"),
        ("pause", "paused", "kite: mission M is paused"),
        ("finish", "capturing", "kite: mission M finishes (it is capturing)"),
        ("finish", "finishing", "kite: mission M finishes: results are being written"),
        ("abort", "capturing", "kite: mission M is being aborted (it is capturing)"),
        ("abort", "finishing", "kite: mission M is being aborted (it is finishing)"),
        ("abort", "aborted", "kite: mission M is aborted"),
        ("resume", "capturing", "kite: mission M goes on (it is capturing)"),
    ],
)
def test_a_stop_is_said_once(verb: str, state: str, says: str) -> None:
    assert VERBS[verb].sentence({"mission_id": "M", "state": state, "durable": True}, "kite") == says


@pytest.mark.parametrize(
    ("verb", "data", "says"),
    [
        ("abort", {}, "kite: no mission had begun; the start is called off"),
        ("pause", {"state": "idle"}, "kite: no mission has begun yet; one that is being planned pauses before any"),
        ("finish", {"state": "idle"}, "kite: no mission has begun yet; one that is being planned finishes before any"),
        ("abort", {"mission_id": "M"}, "kite: mission M is not resumed by itself any more"),
    ],
)
def test_a_stop_of_what_does_not_fly_says_what_becomes_of_it(verb: str, data: dict[str, str], says: str) -> None:
    assert VERBS[verb].sentence(data, "kite").startswith(says)
    assert "not on disk" in VERBS[verb].sentence({**data, "durable": False}, "kite")


@pytest.mark.parametrize(("verb", "done"), [("skip", "is skipped"), ("repeat", "is taken again")])
def test_the_shot_is_named_that_was_not_given(verb: str, done: str) -> None:
    parser = argparse.ArgumentParser()
    VERBS[verb].add_arguments(parser)
    assert VERBS[verb].fields(parser.parse_intermixed_args([])) == {}
    assert VERBS[verb].sentence({"shot": 7, "mission_id": "M"}, "kite") == f"kite: shot 7 {done} in mission M"


def test_a_stop_in_a_hurry_needs_no_quotation_marks() -> None:
    parser = argparse.ArgumentParser()
    VERBS["abort"].add_arguments(parser)
    args = parser.parse_intermixed_args(["a", "--timeout", "3", "helicopter", "nearby"])
    assert VERBS["abort"].fields(args) == {"reason": "a helicopter nearby"}
    assert VERBS["abort"].fields(parser.parse_intermixed_args([])) == {}
