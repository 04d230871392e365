"""Who sent a request: told by its transaction, and in words."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.mqtt.requests import is_transaction
from panoexec.mqtt.senders import CLI, MAVLINK, WEB, received, sender_of, this_user, transaction_of


@given(kind=st.sampled_from([CLI, WEB, MAVLINK]), name=st.text(max_size=300))
def test_a_name_comes_back_from_its_transaction(kind: str, name: str) -> None:
    transaction = transaction_of(kind, name)
    assert is_transaction(transaction)
    told = sender_of(transaction)
    assert told == "".join(char for char in name if char.isprintable())[:60].strip()
    assert transaction_of(kind, name) != transaction


@pytest.mark.parametrize(
    "transaction", [7, "a1", "", "panoexec-cli", "panoexec-cli/x", "panoexec-cli/x/", "b/x/1", "/x/1"]
)
def test_transactions_of_others_name_nobody(transaction: object) -> None:
    assert sender_of(transaction) == ""


def test_a_slash_in_a_name_is_kept() -> None:
    assert sender_of(transaction_of(MAVLINK, "station 255/190", "b-1")) == "station 255/190"
    assert "@" in this_user()


@pytest.mark.parametrize(
    ("event", "text"),
    [
        ({"command": "pause", "by": "anna@laptop", "reason": "rain"}, "pause received from anna@laptop: rain"),
        ({"command": "pause", "by": "anna", "reason": "by anna: rain"}, "pause received from anna: rain"),
        ({"command": "abort", "by": "anna", "reason": "by anna"}, "abort received from anna"),
        (
            {"command": "abort", "by": "station 255/190", "reason": "station 255/190"},
            "abort received from station 255/190",
        ),
        ({"command": "skip", "shot": 7, "by": "anna"}, "skip of shot 7 received from anna"),
        ({"command": "pause", "reason": "rain"}, "pause received: rain"),
        ({"command": 3, "by": [], "reason": {}, "shot": "x"}, "command received"),
    ],
)
def test_a_command_in_words(event: dict[str, Any], text: str) -> None:
    assert received(event) == text
