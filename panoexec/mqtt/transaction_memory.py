"""The transactions that the process knows without asking the disk, and what is not on disk yet."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from panoexec.mqtt.requests import RefusedRequestError, Request

UNWRITTEN: Final = 10_000
"""Responses that are kept for a disk that refuses them; older ones are deleted."""


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
        self._known: dict[str, Known] = {}

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
        self._known = {**stored, **self._known}

    def add(self, request: Request) -> None:
        """Add a transaction whose response is only on disk."""
        self._known[key_of(request)] = Known(request.command, fields_digest(request))

    def forget(self, keys: Iterable[str]) -> None:
        """These transactions are not on disk any more."""
        for key in keys:
            self._known.pop(key, None)

    def answered(self, request: Request, response: bytes) -> None:
        """Add a response that is not on disk yet."""
        known = Known(request.command, fields_digest(request), response)
        self._known[key_of(request)] = self.rows[key_of(request)] = known
        while len(self.rows) > UNWRITTEN:
            self._known.pop(self.rows.popitem(last=False)[0], None)

    def written(self, rows: Mapping[str, Known], values: Mapping[str, str | None]) -> None:
        """These rows and values are on disk now."""
        for key, known in rows.items():
            if self.rows.get(key) is known:
                del self.rows[key]
        for name, value in values.items():
            if self.values.get(name, value) == value:
                self.values.pop(name, None)


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
