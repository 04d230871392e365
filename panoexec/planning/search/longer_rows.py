"""Rows with more images where the sky takes part of them.

The search knows nothing of the sky, which takes part of the images of a row at its height, and with it what neighbours
share. Such a row alone fails C2, and more images in it alone mend that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from panoexec.planning.certificate.verdict import THRESHOLD_SLACK
from panoexec.planning.model import Constraints
from panoexec.planning.search.proposal import Found

_LEAST_APART = 0.1
"""Neighbours are not brought nearer to each other than this part of an image."""

_MOST_MORE = 0.5
"""The images of a row grow by this part of them at most, at a time."""


@dataclass(frozen=True, slots=True)
class Lengthened:
    """A proposal and the (pitch_deg, count) of its rows."""

    path: tuple[tuple[float, int], ...]
    found: Found

    @property
    def row(self) -> int | None:
        """The row in which neighbours overlap least."""
        weakest = self.found.certificate.weakest_h
        return None if weakest is None else self.found.shots[weakest[0]].row


def with_longer_row(now: Lengthened, before: Lengthened | None, constraints: Constraints) -> list[tuple[float, int]]:
    """The (pitch_deg, count) of rows with more images in the row that fails C2 most; empty if that is not what fails.

    So many are added as should make up for what is lacking: as many as brought that much, if the row was longer by some
    already, and else as overlap falls with the spacing of whole images.

    Args:
        now: a proposal.
        before: the one before it, in which one row had fewer images; None if there is none.
        constraints: what is asked for.
    """
    across, row = _across(now.found, constraints), now.row
    if across is None or row is None or constraints.overlap_h - across <= THRESHOLD_SLACK:
        return []
    lack, (pitch, count) = constraints.overlap_h - across, now.path[row]
    more = _more(now.found, lack, count)
    if before is not None and before.row == row and before.path[row][1] < count:
        gained = across - (_across(before.found, constraints) or 0.0)
        more = lack * (count - before.path[row][1]) / gained if gained > 0 else more
    longer = count + max(1, math.ceil(min(more, _MOST_MORE * count)))
    return [*now.path[:row], (pitch, longer), *now.path[row + 1 :]]


def _across(found: Found, constraints: Constraints) -> float | None:
    """The least overlap of neighbours that C2 asks for."""
    certificate = found.certificate
    return certificate.worst_overlap_h if constraints.guarantee == "all" else certificate.min_overlap_h


def _more(found: Found, lack: float, count: int) -> float:
    apart = max(1.0 - (found.certificate.min_overlap_h or 0.0), _LEAST_APART)
    return count * apart / max(apart - lack, _LEAST_APART) - count
