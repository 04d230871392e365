import asyncio
import threading
from collections.abc import Callable

from panoexec.adapters.link.batching import MessageBatcher
from panoexec.adapters.link.message_hub import MavMessage


def message(number: int, *, later_s: float = 0.0) -> MavMessage:
    made = MavMessage("ATTITUDE", 1, {"number": number}, float(number))
    made.heard_s += later_s
    return made


def numbers(messages: list[MavMessage]) -> list[int]:
    return [each.fields["number"] for each in messages]


def test_messages_gather_until_somebody_looks_or_they_have_waited_for_long() -> None:
    taken: list[MavMessage] = []
    posted: list[Callable[[], None]] = []
    inbox = MessageBatcher(taken.append, post=posted.append, eager=lambda: False)
    for number in range(40):
        inbox.put(message(number, later_s=-10.0))
    assert (taken, posted) == ([], [])
    inbox.ingest()
    assert numbers(taken) == list(range(40))
    taken.clear()
    for number in range(40):
        inbox.put(message(number, later_s=0.1 * number))
    assert len(posted) == 1  # one wake-up for all of them
    posted.pop()()
    assert numbers(taken) == list(range(40))
    inbox.ingest()
    assert len(taken) == 40


def test_somebody_who_waits_is_woken_by_the_next_one() -> None:
    taken: list[MavMessage] = []
    posted: list[Callable[[], None]] = []
    inbox = MessageBatcher(taken.append, post=posted.append, eager=lambda: True)
    for number in range(3):
        inbox.put(message(number))
    assert len(posted) == 1
    posted.pop()()
    assert numbers(taken) == [0, 1, 2]
    inbox.put(message(3))
    assert len(posted) == 1


async def test_nothing_is_lost_or_overtaken_in_a_storm_from_another_thread() -> None:
    count = 5000
    taken: list[MavMessage] = []
    came = asyncio.Event()
    waiting = False

    def take(each: MavMessage) -> None:
        taken.append(each)
        came.set()

    loop = asyncio.get_running_loop()

    def post(callback: Callable[[], None]) -> None:
        loop.call_soon_threadsafe(callback)

    inbox = MessageBatcher(take, post=post, eager=lambda: waiting)

    def storm() -> None:
        for number in range(count):
            inbox.put(message(number))

    thread = threading.Thread(target=storm)
    thread.start()
    async with asyncio.timeout(30):
        while len(taken) < count:
            waiting = True  # said before the look, as the thread looks for it after putting
            came.clear()
            inbox.ingest()
            if len(taken) < count:
                await came.wait()
            waiting = False
    thread.join()
    assert numbers(taken) == list(range(count))
