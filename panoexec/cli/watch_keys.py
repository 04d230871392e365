"""The keys of `watch`: each sends the request of an operator's verb, once it is confirmed."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable, Mapping
from types import TracebackType
from typing import Any, Final, Self, TextIO

KEYS: Final[Mapping[str, str]] = {"p": "pause", "r": "resume", "s": "skip", "f": "finish", "a": "abort"}
"""Key and verb."""
HELP: Final = "keys: " + ", ".join(f"{key} {verb}" for key, verb in KEYS.items())
_CONFIRM_S: Final = 10.0
"""A question that was not answered for so long is withdrawn: a later `y` is not meant for it."""
TIMEOUT_S: Final = 30.0
"""For an answer."""


class Keys:
    """What a key does, without a terminal.

    Args:
        vehicle: id, for the question.
        send: sends the request of a verb and returns what came of it as a sentence; what it raises is shown.
        changed: called when `note` has changed.
        now: monotonic seconds.
    """

    def __init__(
        self,
        vehicle: str,
        *,
        send: Callable[[str], Awaitable[str]],
        changed: Callable[[], None],
        now: Callable[[], float],
    ) -> None:
        self._vehicle = vehicle
        self._send = send
        self._changed = changed
        self._now = now
        self._asked = ""
        self._asked_s = 0.0
        self._said = ""
        self._running: set[asyncio.Task[None]] = set()

    @property
    def note(self) -> str:
        """The question that waits for an answer, else what came of the last command, else which keys there are."""
        if self._waiting:
            return f"{self._asked} {self._vehicle}? y yes, any other key no"
        return self._said or HELP

    @property
    def _waiting(self) -> bool:
        return bool(self._asked) and self._now() - self._asked_s <= _CONFIRM_S

    def press(self, key: str) -> None:
        """Take a key: a verb asks, `y` then sends, everything else withdraws the question."""
        if self._waiting:
            verb, self._asked = self._asked, ""
            if key in ("y", "Y"):
                self._said = f"{verb}: sent, waiting for the answer"
                task = asyncio.ensure_future(self._execute(verb))
                self._running.add(task)
                task.add_done_callback(self._running.discard)
            else:
                self._said = f"{verb} was not sent"
        elif key.lower() in KEYS:
            self._asked, self._asked_s = KEYS[key.lower()], self._now()
        else:
            self._asked = self._said = ""
        self._changed()

    async def _execute(self, verb: str) -> None:
        self._said = await self._send(verb)
        self._changed()

    async def close(self) -> None:
        """End what still waits for an answer; the request itself is on its way."""
        for task in self._running:
            task.cancel()
        await asyncio.gather(*self._running, return_exceptions=True)


class TerminalKeys:
    """Reads single keys from a terminal: a context manager, which leaves the terminal as it was. Ctrl-C works on.

    Args:
        stream: standard input.
        press: gets each key.
    """

    def __init__(self, stream: TextIO, press: Callable[[str], None]) -> None:
        self._descriptor = stream.fileno()
        self._press = press
        self._before: Any = None

    def __enter__(self) -> Self:
        import termios  # noqa: PLC0415  (not on Windows)
        import tty  # noqa: PLC0415

        self._before = termios.tcgetattr(self._descriptor)
        tty.setcbreak(self._descriptor)
        asyncio.get_running_loop().add_reader(self._descriptor, self._read)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import termios  # noqa: PLC0415

        asyncio.get_running_loop().remove_reader(self._descriptor)
        # what was typed meanwhile is not meant for the shell
        termios.tcsetattr(self._descriptor, termios.TCSAFLUSH, self._before)

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, 64)
        except OSError:
            data = b""
        if not data:  # the terminal is gone
            asyncio.get_running_loop().remove_reader(self._descriptor)
            return
        # several bytes at once are an arrow key or a paste, and no command
        self._press(data.decode("ascii", "replace") if len(data) == 1 else "")


def can_read_keys(stream: TextIO) -> bool:
    """Whether single keys can be read: a terminal with this process in its foreground, on a system with termios."""
    if sys.platform == "win32":
        return False
    try:
        return stream.isatty() and os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except (OSError, ValueError):  # closed, or not the terminal of this session
        return False
