"""What the operator's verbs say of an answer."""

from __future__ import annotations

import pytest

from panoexec.cli.operate import VERBS


@pytest.mark.parametrize(
    ("verb", "state", "says"),
    [
        ("pause", "capturing", "kite: mission M pauses after the current photo (it is capturing)"),
        ("pause", "paused", "kite: mission M is paused"),
        ("finish", "finishing", "kite: mission M finishes"),
        ("abort", "capturing", "kite: mission M ends for good (it is capturing)"),
        ("abort", "aborted", "kite: mission M is aborted"),
        ("resume", "capturing", "kite: mission M goes on (it is capturing)"),
    ],
)
def test_a_stop_is_said_once(verb: str, state: str, says: str) -> None:
    assert VERBS[verb].sentence({"mission_id": "M", "state": state, "durable": True}, "kite") == says
