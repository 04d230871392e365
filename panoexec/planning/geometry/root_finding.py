"""Vectorised root finding for decreasing functions, by the Illinois variant of false position."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray

Family = Callable[[NDArray[np.intp], FloatArray], FloatArray]
"""Function values (m,), for function indices (m,) and arguments (m,)."""


def last_nonnegative(
    function: Family, lower: FloatArray, upper: FloatArray, precision: float, steps: int
) -> FloatArray:
    """The largest arguments found at which decreasing functions are not negative.

    Args:
        function: see `Family`; it is evaluated only for functions whose root is not yet bracketed closely enough.
        lower: (k,) lower end of the bracket.
        upper: (k,) upper end; at least `lower`.
        precision: width of a bracket at which the iteration stops.
        steps: maximum number of evaluations after the first two.

    Returns:
        (k,): an argument at which the function was evaluated as ≥ 0, `upper` if it is ≥ 0 there, NaN if it is negative
        at `lower`.
    """
    count = len(lower)
    which: NDArray[np.intp] = np.arange(count)
    a, b = lower.astype(np.float64), upper.astype(np.float64)
    good = np.full(count, np.nan)
    if not count:
        return good
    f_b = function(which, b)
    good[f_b >= 0] = b[f_b >= 0]
    which = which[f_b < 0]
    f_a = function(which, a[which]) if len(which) else np.empty(0)
    good[which[f_a >= 0]] = a[which[f_a >= 0]]
    which, f_b, f_a = which[f_a >= 0], f_b[which[f_a >= 0]], f_a[f_a >= 0]
    a, b = a[which], b[which]
    kept = np.zeros(len(which), dtype=np.int64)
    for _ in range(steps):
        wide = b - a > precision
        which, a, b, f_a, f_b, kept = which[wide], a[wide], b[wide], f_a[wide], f_b[wide], kept[wide]
        if not len(which):
            break
        # keep a tenth of the precision away from both ends, so that the bracket shrinks from both sides
        pad = precision / 10
        x = np.clip(a + (b - a) * f_a / (f_a - f_b), a + pad, b - pad)
        f = function(which, x)
        passes = f >= 0
        good[which[passes]] = x[passes]
        # Illinois: halve the value at an end that is kept twice in a row, so that it cannot be kept for ever
        f_b = np.where(passes, np.where(kept == 1, f_b / 2, f_b), f)
        f_a = np.where(passes, f, np.where(kept == -1, f_a / 2, f_a))
        kept = np.where(passes, 1, -1)
        a, b = np.where(passes, x, a), np.where(passes, b, x)
    return good
