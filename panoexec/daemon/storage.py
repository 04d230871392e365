"""Whether missions can be stored: checked at intervals, so that a crew learns of a full disk before the flight."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable
from typing import Final

import structlog

from panoexec.inputs.service_sections import StorageSection
from panoexec.mqtt.transactions import Transactions

_PERIOD_S: Final = 15.0
_PERIOD_IN_TROUBLE_S: Final = 3.0

_log = structlog.get_logger(__name__)


def storage_trouble(section: StorageSection) -> str:
    """Why no mission could be stored there, "" if one could. A folder that does not exist is made when it is needed."""
    try:
        found = os.statvfs(section.path)
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{section.path} cannot be used ({error.strerror})"
    if found.f_flag & os.ST_RDONLY:
        return f"{section.path} is read-only: check the disk, or permit the service to write there"
    free_mb = found.f_bavail * found.f_frsize / 1e6
    if free_mb < section.min_free_mb:
        return f"{section.path} has {free_mb:.0f} MB left: [storage] min_free_mb requires {section.min_free_mb:g}"
    return ""


class StorageMonitor:
    """Checks the storage in `run`, which is one task of the daemon.

    Attributes:
        trouble: why no mission could be stored, "" if one could.
    """

    def __init__(
        self,
        *,
        section: Callable[[], StorageSection],
        transactions: Transactions,
        changed: Callable[[], None],
        on_readable: Callable[[], Awaitable[None]],
        on_recovered: Callable[[], Awaitable[None]],
    ) -> None:
        """Store the collaborators.

        Args:
            section: returns the current `[storage]`.
            transactions: the store whose file is opened as soon as that is possible, and what it could not write is
                written.
            changed: called when there is trouble, or none any more.
            on_readable: called once, when the storage can first be read.
            on_recovered: called each time when there is no trouble any more.
        """
        self.trouble = ""
        self._section = section
        self._transactions = transactions
        self._changed = changed
        self._on_readable = on_readable
        self._on_recovered = on_recovered
        self._was_readable = False
        self._due = asyncio.Event()

    async def check(self) -> None:
        """Check now."""
        closed = await self._transactions.opened()
        trouble = closed or await asyncio.to_thread(storage_trouble, self._section())
        was, self.trouble = self.trouble, trouble
        if trouble != was:
            if trouble:
                _log.warning("storage cannot be used", trouble=trouble)
            else:
                _log.warning("storage recovered")
            self._changed()
        if closed:
            return
        await self._transactions.write_back()
        if not self._was_readable:
            self._was_readable = True
            await self._on_readable()
        elif was and not trouble:
            await self._on_recovered()

    def check_soon(self) -> None:
        """Check without waiting for the next period: something failed that may be the storage's fault."""
        self._due.set()

    async def run(self) -> None:
        """Check every 15 s, in trouble every 3 s."""
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_PERIOD_IN_TROUBLE_S if self.trouble else _PERIOD_S):
                    await self._due.wait()
            self._due.clear()
            await self.check()
