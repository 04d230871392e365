"""What a mistyped word may mean: the nearest of those that are known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

_MOST = 3
"""How many are named at most where several are equally near."""


def nearest(word: str, known: Iterable[str], *, cutoff: float = 0.6) -> list[str]:
    """The known words that are nearest to one, whatever its case; several only if they are equally near, [] if none is.

    What begins with the word is nearer than anything alike: `stat` is short for `status`, not `start` with a wrong
    letter. Among others the most alike wins.

    Args:
        word: as it was typed.
        known: what it may mean.
        cutoff: least likeness (`difflib`'s ratio, 0 to 1).
    """
    typed = word.casefold()
    spelt = {one.casefold(): one for one in known}
    if typed in spelt:
        return [spelt[typed]]
    begun = sorted((one for one in spelt if len(typed) > 1 and one.startswith(typed)), key=lambda one: (len(one), one))
    if begun:
        return [spelt[one] for one in begun[:_MOST]]
    alike = difflib.get_close_matches(typed, spelt, n=_MOST, cutoff=cutoff)
    best = [_likeness(one, typed) for one in alike]
    return [spelt[one] for one, ratio in zip(alike, best, strict=True) if ratio == best[0]]


def did_you_mean(
    word: str, known: Iterable[str] | Mapping[str, str], *, cutoff: float = 0.6, quoted: bool = False
) -> str:
    """`did you mean A?` or `did you mean A or B?`, of what is nearest to a word; "" if nothing is.

    Args:
        word: as it was typed.
        known: what it may mean; a mapping tells what is said of each.
        cutoff: least likeness, as in `nearest`.
        quoted: show the known words in quotation marks.
    """
    said = known if isinstance(known, Mapping) else {one: one for one in known}
    near = [said[one] for one in nearest(word, said, cutoff=cutoff)]
    return f"did you mean {' or '.join(repr(one) if quoted else one for one in near)}?" if near else ""


def _likeness(one: str, typed: str) -> float:
    # the order of the two is that of get_close_matches, whose result is not the same the other way about
    return difflib.SequenceMatcher(None, one, typed).ratio()
