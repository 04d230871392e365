"""Which transactions are forgotten first: those that did the same and are oldest, never those that did something else.

Otherwise many cheap requests push the transaction of an old `start` out of the store, and a copy of that request,
delivered once more by a broker or a client, starts a mission again. Age does not decide, because the clock of a
companion computer may begin in 1970.
"""

from __future__ import annotations

import itertools
import json
import sqlite3
from collections import defaultdict, deque
from typing import Final

KEPT: Final = 10_000
"""Transactions of each command that were obeyed, and of each that were refused; older ones are forgotten."""


class Retention:
    """The transactions on disk, by kind and age."""

    def __init__(self) -> None:
        """Begin with none."""
        self._kinds: dict[tuple[str, bool], deque[str]] = defaultdict(deque)

    def load(self, database: sqlite3.Connection) -> None:
        """Read which transactions were answered; one that was not is never forgotten."""
        self._kinds.clear()
        for key, command, response in database.execute(
            "SELECT id, command, response FROM transactions WHERE response IS NOT NULL ORDER BY number"
        ):
            self._kinds[_kind(command, response)].append(key)

    def due(self, command: str, response: str) -> list[str]:
        """The transactions to be forgotten when this answer is stored; nothing changes yet, as it may not be stored."""
        kind = self._kinds[_kind(command, response)]
        return list(itertools.islice(kind, max(0, len(kind) + 1 - KEPT)))

    def answered(self, key: str, command: str, response: str) -> None:
        """Note an answer that is on disk now, and that those that were `due` are not any more."""
        kind = self._kinds[_kind(command, response)]
        kind.append(key)
        while len(kind) > KEPT:
            kind.popleft()


def _kind(command: str, response: str) -> tuple[str, bool]:
    try:
        obeyed = json.loads(response).get("status") == "ok"
    except (ValueError, AttributeError):
        obeyed = True  # of a request that nobody understands, the safe assumption
    return command, obeyed
