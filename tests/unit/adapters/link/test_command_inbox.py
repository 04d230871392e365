"""A command is carried out once, however often it arrives."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from panoexec.adapters.link.command_inbox import COPY_S, REPEAT_S, Repetitions, Result, StationCommand

START = StationCommand(sender=(255, 190), params=(1.0, 2.0, *(float("nan"),) * 5))


def test_copies_of_one_that_runs_or_has_just_run_are_not_carried_out() -> None:
    known = Repetitions()
    assert known.take(START, 10.0) == (True, None)
    assert known.take(START, 10.1) == (False, None)
    assert known.take(START, 19.0) == (False, None), "it still runs"
    known.done(START, Result.ACCEPTED, 19.5)
    assert known.take(replace(START, confirmation=1), 19.6) == (False, Result.ACCEPTED)


def test_a_repetition_gets_the_answer_so_far() -> None:
    known = Repetitions()
    known.take(START, 10.0)
    assert known.take(replace(START, confirmation=1), 11.0) == (False, Result.IN_PROGRESS)
    assert known.take(replace(START, confirmation=1), 11.1) == (False, None), "a copy of the repetition"
    known.done(START, Result.DENIED, 12.0)
    assert known.take(replace(START, confirmation=2), 12.5) == (False, Result.DENIED)


def test_a_stop_whose_first_copy_was_lost_is_no_repetition_of_one_before_a_start() -> None:
    """It was answered with ACCEPTED, the answer to the earlier one, and not carried out."""
    known = Repetitions(stops=lambda command: command.params[0] == 4.0)
    abort = replace(START, params=(4.0, *START.params[1:]))
    assert known.take(abort, 10.0) == (True, None)
    known.done(abort, Result.ACCEPTED, 10.1)
    assert known.take(replace(abort, confirmation=1), 10.6) == (False, Result.ACCEPTED)
    assert known.take(START, 11.0) == (True, None)
    known.done(START, Result.ACCEPTED, 11.5)
    assert known.take(replace(abort, confirmation=2), 14.0) == (True, None)
    known.done(abort, Result.ACCEPTED, 14.1)
    assert known.take(replace(START, confirmation=1), 14.2) == (False, Result.ACCEPTED), "what starts, never twice"
    assert known.take(replace(abort, confirmation=3), 14.3) == (False, Result.ACCEPTED)
    assert known.take(replace(START, sender=(254, 190)), 14.4) == (True, None)
    assert known.take(replace(abort, confirmation=4), 14.5) == (False, Result.ACCEPTED), "another station's start"


def test_the_same_again_later_is_a_new_one() -> None:
    known = Repetitions()
    known.take(START, 10.0)
    known.done(START, Result.ACCEPTED, 10.01)
    assert known.take(START, 10.0 + COPY_S - 0.01) == (False, None)
    assert known.take(START, 10.0 + COPY_S + 0.01) == (True, None)
    known.done(START, Result.ACCEPTED, 11.0)
    assert known.take(replace(START, confirmation=1), 11.0 + REPEAT_S + 0.1) == (True, None)


def test_others_and_other_parameters_are_others() -> None:
    known = Repetitions()
    assert known.take(START, 10.0) == (True, None)
    assert known.take(replace(START, sender=(254, 190)), 10.0) == (True, None)
    assert known.take(replace(START, params=(2.0, *START.params[1:])), 10.0) == (True, None)


@given(
    arrivals=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.floats(0, 0.4)), max_size=60),
    ends=st.lists(st.booleans(), min_size=60, max_size=60),
)
def test_none_runs_twice_at_a_time(arrivals: list[tuple[int, int, float]], ends: list[bool]) -> None:
    known, running, now_s = Repetitions(), set[int](), 0.0
    for (number, confirmation, passed_s), end in zip(arrivals, ends, strict=False):
        now_s += passed_s
        command = replace(START, params=(float(number), *START.params[1:]), confirmation=confirmation)
        is_new, _ = known.take(command, now_s)
        assert not (is_new and number in running)
        if is_new:
            running.add(number)
        if end and number in running:
            running.discard(number)
            known.done(command, Result.ACCEPTED, now_s)


def test_what_is_remembered_is_bounded() -> None:
    known = Repetitions()
    for number in range(1000):
        known.take(replace(START, params=(float(number), *START.params[1:])), 0.0)
    assert len(known._known) <= 64
