"""Which shot comes next."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from panoexec.mission.shot_queue import Decision, ShotQueue, Task


def test_retakes_come_at_once_then_after_the_others_then_never() -> None:
    queue = ShotQueue([0, 1], attempts=2, rounds=2)
    log = []
    while (task := queue.take()) is not None:
        decision = queue.rejected(task.shot) if task.shot == 0 else None
        log.append((task.shot, task.round, decision))
    assert log == [
        (0, 0, Decision.AT_ONCE),
        (0, 0, Decision.LATER),
        (1, 0, None),
        (0, 1, Decision.AT_ONCE),
        (0, 1, Decision.GIVE_UP),
    ]


def test_an_interrupted_shot_comes_first_again_and_is_not_counted() -> None:
    queue = ShotQueue([0, 1], attempts=1, rounds=1)
    assert queue.take() == Task(0, 0)
    for _ in range(5):
        queue.put_back(0)
        assert queue.take() == Task(0, 0)
    assert queue.rejected(0) is Decision.GIVE_UP


def test_a_repeat_has_all_its_attempts_again() -> None:
    queue = ShotQueue([0], attempts=1, rounds=2)
    queue.take()
    assert queue.rejected(0) is Decision.LATER
    queue.take()
    assert queue.rejected(0) is Decision.GIVE_UP
    queue.add(0)
    assert queue.take() == Task(0, 0)
    assert queue.rejected(0) is Decision.LATER
    assert queue.round_of(0) == 1


@given(
    count=st.integers(1, 8),
    attempts=st.integers(1, 3),
    rounds=st.integers(1, 3),
    script=st.lists(st.sampled_from(["accept", "reject", "put_back", "drop", "add"]), max_size=200),
)
def test_no_shot_is_lost_or_twice_in_it_and_no_more_attempts_than_allowed(
    count: int, attempts: int, rounds: int, script: list[str]
) -> None:
    queue = ShotQueue(range(count), attempts=attempts, rounds=rounds)
    tries = dict.fromkeys(range(count), 0)
    waiting = set(range(count))
    for step in script:
        task = queue.take()
        if task is None:
            assert not waiting
            break
        assert task.shot in waiting
        assert task.shot not in queue
        waiting.remove(task.shot)
        if step == "reject":
            tries[task.shot] += 1
            assert tries[task.shot] <= attempts * rounds
            if queue.rejected(task.shot) is not Decision.GIVE_UP:
                waiting.add(task.shot)
            else:
                assert tries[task.shot] == attempts * rounds
        elif step == "put_back":
            queue.put_back(task.shot)
            waiting.add(task.shot)
        elif step == "add":
            queue.add(task.shot)
            queue.add(task.shot)
            waiting.add(task.shot)
            tries[task.shot] = 0
        assert len(queue) == len(waiting)
        assert all(shot in queue for shot in waiting)
