"""What is urgent is sent while other messages wait for their acknowledgements."""

from __future__ import annotations

import asyncio
import json
import time
from types import SimpleNamespace
from typing import Any, cast

import pytest

from panoexec.mqtt.client import REFUSED
from panoexec.mqtt.dialer import BEST
from panoexec.mqtt.messages import dump
from panoexec.mqtt.outbox import Outgoing
from panoexec.mqtt.sender import BATCH, Sender
from panoexec.mqtt.topics import Topics
from tests.unit.mqtt.test_state_deltas import plain
from tests.waiting import eventually


class Client:
    """A broker that acknowledges when it is told to."""

    def __init__(self, most_unacknowledged: int) -> None:
        self.limits = SimpleNamespace(most_unacknowledged=most_unacknowledged, largest_packet=None)
        self.acknowledges = asyncio.Event()
        self.heard: list[bytes] = []

    async def send(self, _topic: str, payload: bytes, **_: Any) -> int:
        self.heard.append(payload)
        await self.acknowledges.wait()
        return 0


def answer(payload: bytes, *, urgent: bool = False) -> Outgoing:
    return Outgoing(topic="response/x", payload=payload, answer=True, urgent=urgent)


@pytest.mark.parametrize(("most", "at_once"), [(1000, True), (BATCH, False)])
async def test_an_urgent_answer_does_not_wait_for_acknowledgements(most: int, at_once: bool) -> None:
    sender, client, stop = Sender(Topics("p", "v"), five=True, keepalive_s=30.0), Client(most), asyncio.Event()
    for number in range(BATCH + 2):
        sender.put(answer(str(number).encode()))
    sending = asyncio.create_task(
        sender.run(cast("Any", client), online=b"online", pulse=lambda: None, stop=stop), name="sending"
    )
    await eventually(lambda: len(client.heard) == BATCH)
    sender.put(answer(b"stopped", urgent=True))
    for _ in range(20):
        await asyncio.sleep(0)
    assert (b"stopped" in client.heard) == at_once, "as far as the broker accepts more"
    client.acknowledges.set()
    stop.set()
    sender.outbox.filled.set()
    await sending
    assert len(sender.outbox) == 0
    assert client.heard.index(b"stopped") == BATCH
    assert len(client.heard) == len(set(client.heard)) == BATCH + 3, "each once"


async def test_the_last_state_leaves_whatever_the_pace_of_the_link() -> None:
    sender, client, stop = Sender(Topics("p", "v"), five=True, keepalive_s=30.0), Client(1000), asyncio.Event()
    client.acknowledges.set()
    sender.connected(BEST, round_trip_s=0.0)
    sender.pace.acknowledged(1000, 1.0, now_s=time.monotonic(), latest=1000)
    sender.put(Outgoing(topic="p/v/state", payload=b"last", retain=True))
    assert sender.next_batch(cast("Any", client)) == [], "a state was just sent, and took its share"
    stop.set()
    await sender.run(cast("Any", client), online=b"online", pulse=lambda: None, stop=stop)
    assert client.heard == [b"last"]


class Refusing:
    """A broker whose ACL knows nothing of deltas."""

    limits = SimpleNamespace(most_unacknowledged=1000, largest_packet=None)

    def __init__(self, *, refuses: bool) -> None:
        self.refuses = refuses
        self.heard: list[tuple[str, int]] = []

    async def send(self, topic: str, payload: bytes, **_: Any) -> int:
        document = json.loads(payload)
        self.heard.append((topic, document.get("patch", document)["attempts"]))
        return REFUSED + 7 if self.refuses and topic.endswith("delta") else 0


@pytest.mark.parametrize("refuses", [True, False])
async def test_a_state_whose_delta_is_refused_goes_as_a_whole(refuses: bool) -> None:
    sender, client = Sender(Topics("p", "v"), five=True, keepalive_s=30.0), Refusing(refuses=refuses)
    sender.connected(BEST, round_trip_s=0.0)
    for attempts in range(1, 5):
        sender.put(Outgoing(topic="p/v/state", payload=dump(plain(attempts=attempts)), retain=True))
        while len(sender.outbox):
            sender.pace.lastingly_slow = True
            await sender._send_batch(cast("Any", client), sender.next_batch(cast("Any", client)))
    whole, delta = "p/v/state", "p/v/state/delta"
    if refuses:
        assert client.heard == [(whole, 1), (delta, 2), (whole, 2), (whole, 3), (whole, 4)]
    else:
        assert client.heard == [(whole, 1), (delta, 2), (delta, 3), (delta, 4)]
    assert len(sender.outbox) == 0
