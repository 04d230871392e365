"""The transactions that the process knows without asking the disk, and what is not on disk yet."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from panoexec.mqtt.requests import RefusedRequestError, Request

KEPT: Final = 10_000
"""Transactions that are kept, on disk and in memory; older ones are deleted."""


@dataclass(frozen=True, slots=True)
class Known:
    """A transaction with an effect.

    Attributes:
        command: its command.
        digest: of the fields of its request.
        response: as JSON; None: it has none, or it is on disk only.
    """

    command: str
    digest: str
    response: bytes | None = None

    def check_same(self, request: Request) -> None:
        """Raise if another request has this transaction.

        Raises:
            RefusedRequestError: `conflict`.
        """
        if (self.command, self.digest) != (request.command, fields_digest(request)):
            raise conflict(self.command, request)


class TransactionMemory:
    """All stored transactions, with the response of stopping requests only, and what could not be stored yet.

    Attributes:
        rows: responses that are not on disk, by key, oldest first.
        values: values that are not on disk, by name; None: to be deleted.
    """

    def __init__(self) -> None:
        self.rows: OrderedDict[str, Known] = OrderedDict()
        self.values: dict[str, str | None] = {}
        self._known: OrderedDict[str, Known] = OrderedDict()

    def find(self, request: Request) -> Known | None:
        """The transaction of a request, None if it is new.

        Raises:
            RefusedRequestError: another request has it.
        """
        known = self._known.get(key_of(request))
        if known is not None:
            known.check_same(request)
        return known

    def find_unwritten(self, request: Request) -> bytes | None:
        """The response to a request if it is not on disk yet.

        Raises:
            RefusedRequestError: another request has the transaction.
        """
        known = self.rows.get(key_of(request))
        if known is None:
            return None
        known.check_same(request)
        return known.response

    def add_stored(self, stored: Mapping[str, Known]) -> None:
        """Add the transactions on disk, oldest first; those of this process remain as they are."""
        self._known = OrderedDict({**stored, **self._known})

    def add(self, request: Request) -> None:
        """Add a transaction whose response is only on disk."""
        self._add(key_of(request), Known(request.command, fields_digest(request)))

    def answered(self, request: Request, response: bytes) -> None:
        """Add a response that is not on disk yet."""
        known = Known(request.command, fields_digest(request), response)
        self._add(key_of(request), known)
        self.rows[key_of(request)] = known
        while len(self.rows) > KEPT:
            self.rows.popitem(last=False)

    def written(self, rows: Mapping[str, Known], values: Mapping[str, str | None]) -> None:
        """These rows and values are on disk now."""
        for key, known in rows.items():
            if self.rows.get(key) is known:
                del self.rows[key]
        for name, value in values.items():
            if self.values.get(name, value) == value:
                self.values.pop(name, None)

    def _add(self, key: str, known: Known) -> None:
        self._known[key] = known
        while len(self._known) > KEPT:
            self._known.popitem(last=False)


def key_of(request: Request) -> str:
    """The transaction as text, in which the number 1 is not the string "1"."""
    return json.dumps(request.transaction)


def fields_digest(request: Request) -> str:
    """A digest of the fields of a request."""
    fields = json.dumps(request.model_dump(mode="python"), sort_keys=True)
    return hashlib.sha256(fields.encode()).hexdigest()


def conflict(command: str, request: Request | None = None) -> RefusedRequestError:
    """The error for a transaction that another request, with this command, has."""
    return RefusedRequestError(
        "conflict",
        f"the transaction was used already for another request ({command}): give each request its own",
        field="transaction",
        transaction=None if request is None else request.transaction,
    )


def interrupted(request: Request) -> RefusedRequestError:
    """The error for a transaction that was in progress when its process died."""
    return RefusedRequestError(
        "interrupted",
        "the daemon ended while it executed this request, which is not executed again: the state shows whether it was",
        transaction=request.transaction,
    )
