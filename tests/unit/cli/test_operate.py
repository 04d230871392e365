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
        ("finish", "capturing", "kite: mission M finishes"),
        ("abort", "capturing", "kite: mission M is aborted"),
        ("resume", "capturing", "kite: mission M goes on (it is capturing)"),
    ],
)
def test_a_stop_is_said_once(verb: str, state: str, says: str) -> None:
    assert VERBS[verb].sentence({"mission_id": "M", "state": state, "durable": True}, "kite") == says


def test_a_stop_in_a_hurry_needs_no_quotation_marks() -> None:
    parser = argparse.ArgumentParser()
    VERBS["abort"].add_arguments(parser)
    args = parser.parse_intermixed_args(["a", "--timeout", "3", "helicopter", "nearby"])
    assert VERBS["abort"].fields(args) == {"reason": "a helicopter nearby"}
    assert VERBS["abort"].fields(parser.parse_intermixed_args([])) == {}
