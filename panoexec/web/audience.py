"""The browsers: each has a queue of bounded length, so that a slow one costs nobody else anything."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Final

from panoexec.web.access import User

QUEUE_BYTES: Final = 4_000_000
"""What may wait for one browser; one that is slower is cut off, and gets a snapshot when it comes back."""

SEND_S: Final = 10.0
"""A single message that takes longer ends the connection."""


class Browser:
    """One WebSocket.

    Attributes:
        user: who it is.
        name: in the log.
        follows: id of a vehicle; None for the list of all.
        token: of its session; None without one.
        ended: whether nothing is sent any more, because more waits than may, or its session is over.
        on_end: called then; closes the connection, even if it is stuck in the middle of a message.
    """

    def __init__(self, user: User, *, name: str, token: str | None = None) -> None:
        self.user = user
        self.name = name
        self.follows: str | None = None
        self.token = token
        self.ended = False
        self.on_end: Callable[[], None] = lambda: None
        self.commands: deque[float] = deque(maxlen=64)
        self._queue: deque[str] = deque()
        self._bytes = 0
        self._filled = asyncio.Event()

    def put(self, message: str) -> None:
        """Queue a message."""
        if self.ended:
            return
        self._queue.append(message)
        self._bytes += len(message)
        if self._bytes > QUEUE_BYTES and len(self._queue) > 1:
            self.end()
        self._filled.set()

    def end(self) -> None:
        """Cut it off."""
        self.ended = True
        self._queue.clear()
        self.on_end()
        self._filled.set()

    async def deliver(self, send: Callable[[str], Awaitable[None]]) -> None:
        """Send what is queued, until the browser is cut off.

        Raises:
            TimeoutError: a message was not taken in time.
        """
        while not self.ended:
            self._filled.clear()
            while self._queue:
                message = self._queue.popleft()
                self._bytes -= len(message)
                async with asyncio.timeout(SEND_S):
                    await send(message)
            await self._filled.wait()


class Browsers:
    """Implements `Audience`."""

    def __init__(self) -> None:
        self.all: set[Browser] = set()
        self._followed: dict[str, set[Browser]] = {}

    def add(self, browser: Browser) -> None:
        """A browser came."""
        self.all.add(browser)

    def remove(self, browser: Browser) -> None:
        """A browser went."""
        self.all.discard(browser)
        self.follow(browser, None)

    def follow(self, browser: Browser, vehicle: str | None) -> None:
        """A browser follows another vehicle, or none."""
        if browser.follows is not None:
            followers = self._followed.get(browser.follows, set())
            followers.discard(browser)
            if not followers:
                self._followed.pop(browser.follows, None)
        browser.follows = vehicle
        if vehicle is not None:
            self._followed.setdefault(vehicle, set()).add(browser)

    def followed(self) -> list[str]:
        """The vehicles that somebody follows."""
        return list(self._followed)

    def is_followed(self, vehicle: str) -> bool:
        """See `Audience`."""
        return vehicle in self._followed

    def tell(self, vehicle: str, message: str) -> None:
        """See `Audience`."""
        for browser in self._followed.get(vehicle, ()):
            browser.put(message)

    def tell_all(self, message: str) -> None:
        """See `Audience`."""
        for browser in self.all:
            browser.put(message)

    def tell_lists(self, message: str) -> None:
        """To those who look at the list of vehicles."""
        for browser in self.all:
            if browser.follows is None:
                browser.put(message)
