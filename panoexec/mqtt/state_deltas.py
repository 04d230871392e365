"""States as differences from an earlier one, for slow links: JSON merge patches (RFC 7386), and who follows them.

Each delta is the difference from the last *whole* state that the broker has, not from the delta before: a delta that is
lost is made up for by the next one. It names that state by `boot_id` and `base`. Whoever does not have it notices, and
waits for the next whole state.
"""

from __future__ import annotations

import json
from typing import Any, Final, TypeAlias

Document: TypeAlias = dict[str, Any]

_COUNTS: Final = "content"
"""The object of a state whose members come and go; all others have always the same ones."""


def merge_patch(old: Document, new: Document) -> Document:
    """The patch that makes one JSON object the other; a member that is null in `new` may be missing afterwards."""
    patch: Document = {key: None for key in old if key not in new and old[key] is not None}
    for key, value in new.items():
        before = old.get(key)
        if isinstance(value, dict) and isinstance(before, dict):
            if inner := merge_patch(before, value):
                patch[key] = inner
        elif value != before or isinstance(value, bool) is not isinstance(before, bool):  # in Python 1 equals True
            patch[key] = value
    return patch


def patched(document: Any, patch: Any) -> Any:
    """A JSON value after a merge patch, as RFC 7386 has it; the arguments stay as they are."""
    if not isinstance(patch, dict):
        return patch
    out = dict(document) if isinstance(document, dict) else {}
    for key, value in patch.items():
        if value is None:
            out.pop(key, None)
        else:
            out[key] = patched(out.get(key), value)
    return out


def delta_payload(base: Document, state: Document) -> bytes | None:
    """The payload that makes one state of a process another one of the same; None if a merge patch cannot say that.

    It cannot where an object with a null in it takes the place of a null.
    """
    patch = merge_patch(base, state)
    if base["boot_id"] != state["boot_id"] or _with_nulls(patched(base, patch), base) != state:
        return None
    delta = {"boot_id": base["boot_id"], "base": base["seq"], "patch": patch}
    return json.dumps(delta, separators=(",", ":"), allow_nan=False).encode("ascii")


class StateFollower:
    """The states of one vehicle, from whole states and deltas in the order of their arrival."""

    def __init__(self) -> None:
        """Begin without a state."""
        self._base: Document = {}
        self._state: Document = {}

    def whole(self, document: Any) -> Any:
        """Take a whole state; returns the newest one, which is another one if this is a repetition."""
        if not isinstance(document, dict):
            return document
        self._base = document
        if not self._is_older(document):
            self._state = document
        return self._state

    def delta(self, document: Any) -> Document | None:
        """Take a delta; returns the whole state, or None if it is nothing new or builds on a state that is not here."""
        if not isinstance(document, dict) or not isinstance(patch := document.get("patch"), dict):
            return None
        base = self._base
        known = (base.get("boot_id"), base.get("seq"))
        if not base or known != (document.get("boot_id"), document.get("base")):
            return None
        try:
            state = _with_nulls(patched(base, patch), base)
        except RecursionError:
            return None  # no state is nested so deeply
        if state == self._state or self._is_older(state):
            return None
        self._state = state
        return state

    def _is_older(self, state: Document) -> bool:
        """Whether it is older than the newest one of the same process."""
        ours, theirs = self._state.get("seq"), state.get("seq")
        same = self._state.get("boot_id") == state.get("boot_id")
        return same and isinstance(ours, int) and isinstance(theirs, int) and theirs < ours


def _with_nulls(state: Document, base: Document) -> Document:
    """A merge patch cannot say null: members of a state that it removes are null."""
    out: Document = {}
    for key, before in base.items():
        value = state.get(key)
        nested = isinstance(value, dict) and isinstance(before, dict) and key != _COUNTS
        out[key] = _with_nulls(value, before) if nested and isinstance(value, dict) else value
    return out | {key: value for key, value in state.items() if key not in base}
