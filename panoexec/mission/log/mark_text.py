"""The marks of shots, and their one-line text: what a remote view needs, which loads no mission."""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import StrEnum
from itertools import groupby
from typing import Final


class ShotMark(StrEnum):
    """The state of a shot in a map; the value is its letter in the text."""

    TO_DO = "t"
    CURRENT = "c"
    """Being taken."""
    DONE = "d"
    """Accepted at the first try."""
    RETAKEN = "r"
    """Accepted at a later try."""
    AGAIN = "a"
    """Rejected, to be taken again."""
    MISSING = "m"
    """Missed or skipped; or not taken when the mission ended."""


_RUN: Final = re.compile(r"([tcdram])([1-9][0-9]{0,6})")


def in_runs(marks: Iterable[ShotMark]) -> str:
    """Marks run-length encoded: `d12 r1 c1 t42`."""
    return " ".join(f"{mark.value}{sum(1 for _ in run)}" for mark, run in groupby(marks))


def marks_from_text(text: str, *, count: int) -> list[ShotMark]:
    """Parse a text of `in_runs` with `count` shots; empty if it is not valid."""
    runs = [_RUN.fullmatch(part) for part in text.split(" ")]
    if any(run is None for run in runs) or sum(int(run[2]) for run in runs if run) != count:
        return []
    return [ShotMark(run[1]) for run in runs if run for _ in range(int(run[2]))]
