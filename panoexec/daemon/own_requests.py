"""Requests that the daemon makes of itself, for others than its broker: they take the way of all requests."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from typing import Any

from panoexec.mission.tour_stop import TourStop
from panoexec.mqtt.incoming import Incoming, next_arrival


def submit(
    take: Callable[[Incoming], None],
    verb: str,
    fields: Mapping[str, Any],
    *,
    transaction: str,
    stop: TourStop | None = None,
) -> asyncio.Future[bytes]:
    """Give a request to whoever takes requests; its response, as JSON.

    Args:
        take: takes it.
        verb: the request's command.
        fields: of the request.
        transaction: unique.
        stop: the stop of a tour at which its mission is flown.
    """
    answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
    payload = json.dumps({"transaction": transaction, **fields}).encode()

    def reply(response: bytes) -> None:
        if not answer.done():
            answer.set_result(response)

    take(
        Incoming(
            command=verb,
            payload=payload,
            size=len(payload),
            received_s=time.monotonic(),
            arrival=next_arrival(),
            reply=reply,
            stop=stop,
        )
    )
    return answer
