"""The outbox keeps order, bounds and priorities; the message that ends connections is found."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.mqtt.outbox import OVERDUE_S, SLOW_OVERDUE_S, Outbox, Outgoing
from panoexec.mqtt.suspicion import Suspicion


def message(
    topic: str, payload: bytes = b"x", *, retain: bool = False, answer: bool = False, urgent: bool = False
) -> Outgoing:
    return Outgoing(topic=topic, payload=payload, retain=retain, answer=answer, urgent=urgent)


async def test_the_outbox_keeps_order_and_only_the_newest_retained() -> None:
    box = Outbox()
    first, second = message("event", b"1"), message("event", b"2")
    box.put(first)
    box.put(message("state", b"old", retain=True))
    box.put(message("state", b"new", retain=True))
    box.put(second)
    batch = box.take(10)
    assert [one.payload for one in batch] == [b"1", b"2", b"new"]
    for one in batch:
        box.done(one)
    assert len(box) == 0
    assert not box.filled.is_set()
    box.renew()
    assert [one.payload for one in box.take(10)] == [b"new"], "a new connection gets the state again"


async def test_a_state_that_changed_while_the_old_one_was_sent_goes_out_too() -> None:
    box = Outbox()
    box.put(message("state", b"old", retain=True))
    sent = box.take(1)[0]
    box.put(message("state", b"new", retain=True))
    box.done(sent)
    assert [one.payload for one in box.take(1)] == [b"new"]


async def test_an_urgent_answer_goes_before_a_flood_of_others_and_is_not_pushed_out_by_it() -> None:
    box = Outbox(answers=3)
    box.put(message("response/abort", b"stopped", answer=True, urgent=True))
    for number in range(5):
        box.put(message("response/plan", str(number).encode(), answer=True))
    assert [one.payload for one in box.take(10)] == [b"stopped", b"2", b"3", b"4"]
    assert len(box) == 4
    for one in box.take(10):
        box.done(one)
    assert len(box) == 0
    assert not box.filled.is_set()


async def test_the_outbox_is_bounded_by_number_and_bytes() -> None:
    box = Outbox(limit=3, limit_bytes=10)
    for number in range(5):
        box.put(message("event", str(number).encode()))
    assert [one.payload for one in box.take(10)] == [b"2", b"3", b"4"]
    box.put(message("event", b"12345678"))
    assert [one.payload for one in box.take(10)] == [b"3", b"4", b"12345678"]
    assert box.dropped == 3


def test_the_message_at_which_the_connection_ends_again_and_again_is_found() -> None:
    good, bad = message("event", b"good"), message("event", b"bad")
    suspicion = Suspicion()
    assert not suspicion.ended(good, alone=False)
    assert suspicion.wary, "one by one from now on"
    assert not suspicion.ended(good, alone=True)
    suspicion.acknowledged([good], left=1)
    assert [suspicion.ended(bad, alone=True) for _ in range(3)] == [False, False, True]
    suspicion.acknowledged([good], left=0)
    assert not suspicion.wary


def test_links_that_are_lost_now_and_then_condemn_nothing() -> None:
    suspicion, event = Suspicion(), message("event")
    for _ in range(10):
        assert not suspicion.ended(event, alone=True)
        assert not suspicion.ended(event, alone=True)
        suspicion.acknowledged([event], left=0)


async def test_what_is_given_up_goes_out_no_more() -> None:
    box = Outbox()
    event, state = message("event"), message("state", retain=True)
    box.put(event)
    box.put(state)
    box.give_up(event)
    assert box.take(9) == [state]
    box.give_up(state)
    box.renew()
    assert box.take(9) == []
    assert not box.filled.is_set()
    assert box.dropped == 2


def test_answers_go_before_events_and_events_before_the_state_unless_it_is_overdue() -> None:
    now = [0.0]
    box = Outbox(clock=lambda: now[0])
    event, state, answer = message("event"), message("state", retain=True), message("response/get", answer=True)
    for one in (event, state, answer):
        box.put(one)
    assert box.take(9) == [answer, event, state]
    now[0] = OVERDUE_S / 2
    newer = message("state", b"newer", retain=True)
    box.put(newer)
    now[0] = OVERDUE_S
    assert box.take(9) == [answer, newer, event], "a state that waits does not wait longer because it changes"
    box.done(newer)
    box.put(state)
    assert box.take(9) == [answer, event, state]


def test_a_delta_in_place_of_a_state_does_not_wait_long_behind_events() -> None:
    now = [0.0]
    box = Outbox(clock=lambda: now[0])
    event, state = message("event"), message("state", retain=True)
    delta = replace(message("state/delta", b"d"), stands_for=state)
    box.put(event)
    box.put(state)
    assert box.take(9, form=lambda *_: delta) == [event, delta]
    now[0] = SLOW_OVERDUE_S
    assert box.take(9, form=lambda *_: delta) == [delta, event]
    assert box.take(9, form=lambda *_: None) == [event]
    box.done(delta)
    assert (box.take(9), box.held("state")) == ([event], None), "the state is sent, but the broker has no whole one"
    newer = message("state", b"newer", retain=True)
    box.put(state)
    box.put(newer)
    box.done(delta)
    assert box.take(9) == [event, newer]


def test_no_more_bytes_are_taken_than_the_link_bears_at_once_but_one_message() -> None:
    box = Outbox()
    events = [message("event", 200 * b"x") for _ in range(5)]
    for event in events:
        box.put(event)
    assert box.take(9, 2.5 * events[0].size) == events[:2]
    assert box.take(9, 1.0) == events[:1]


@given(st.lists(st.sampled_from(["answer", "event", "state"]), max_size=60))
def test_a_flood_of_answers_pushes_no_event_out(kinds: list[str]) -> None:
    box = Outbox(limit=100, answers=5)
    put: dict[str, list[Outgoing]] = {"answer": [], "event": [], "state": []}
    for number, kind in enumerate(kinds):
        one = message(kind, str(number).encode(), retain=kind == "state", answer=kind == "answer")
        put[kind].append(one)
        box.put(one)
    assert box.take(1000) == put["answer"][-5:] + put["event"] + put["state"][-1:]
    assert box.dropped == max(0, len(put["answer"]) - 5)
    for one in box.take(1000):
        box.done(one)
    assert len(box) == 0


@pytest.mark.parametrize("retain", [True, False])
def test_what_the_broker_has_is_known_until_the_connection_ends(retain: bool) -> None:
    box = Outbox()
    plan = message("plan", b"1", retain=retain)
    box.put(plan)
    assert not box.is_held(plan)
    box.done(plan)
    assert box.is_held(plan) is retain
    assert not box.is_held(message("plan", b"2", retain=True))
    box.renew()
    assert not box.is_held(plan)
