"""What is suggested for a mistyped word (panoexec/suggestions.py)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.cli.app import COMMANDS, run
from panoexec.mqtt.topics import COMMANDS as REQUESTS
from panoexec.suggestions import did_you_mean, nearest

WORDS = st.text(alphabet="abcdefgh-_ABC", min_size=1, max_size=8)


@pytest.mark.parametrize("verb", COMMANDS)
def test_each_verb_with_a_letter_missing_or_two_swapped_is_recognized(verb: str) -> None:
    for at in range(1, len(verb)):
        for typed in (verb[:at] + verb[at + 1 :], verb[: at - 1] + verb[at] + verb[at - 1] + verb[at + 1 :]):
            # `stat` is the beginning of `status` as well
            assert verb in nearest(typed, COMMANDS) or any(one.startswith(typed) for one in COMMANDS), typed


@given(WORDS, st.lists(WORDS, max_size=6))
def test_only_known_words_are_suggested_and_a_known_one_before_all(word: str, known: list[str]) -> None:
    near = nearest(word, known)
    assert set(near) <= set(known)
    assert len(near) <= 3
    assert [one.casefold() for one in nearest(word, [*known, word])] == [word.casefold()]


def test_what_begins_with_the_word_is_nearer_than_what_is_alike() -> None:
    assert nearest("stat", ["start", "status"]) == ["status"]
    assert nearest("sta", ["start", "status", "resume"]) == ["start", "status"]
    assert nearest("elevation", ["elevator", "elevation_deg"]) == ["elevation_deg"]


def test_the_most_alike_wins_and_equals_are_all_named() -> None:
    assert nearest("statu5", ["start", "status"]) == ["status"]
    assert set(nearest("vehicle3", ["vehicle1", "vehicle2", "other"])) == {"vehicle1", "vehicle2"}
    assert nearest("xyz", ["start"]) == []
    assert did_you_mean("xyz", ["start"]) == ""


def test_a_mapping_tells_what_is_said() -> None:
    assert did_you_mean("gte", {"get": "send get"}, quoted=True) == "did you mean 'send get'?"


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["send", "statu"], "unknown command 'statu': did you mean 'panoexec status'?"),
        (["send", "strat"], "did you mean 'start'?"),
        (["stat"], "did you mean 'status'?"),
        (["Status"], "did you mean 'status'?"),
        (["presets"], "did you mean 'send presets'?"),
        (["plan", "--elev", "-60", "10"], "unknown option --elev: did you mean --elevation?"),
    ],
)
def test_requests_and_verbs_name_each_other(argv: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(argv) == 2
    assert told in capsys.readouterr().err


def test_each_request_without_a_verb_is_named_as_a_request(capsys: pytest.CaptureFixture[str]) -> None:
    for request in set(REQUESTS) - set(COMMANDS):
        assert run([request]) == 2
        assert f"did you mean 'send {request}'?" in capsys.readouterr().err
