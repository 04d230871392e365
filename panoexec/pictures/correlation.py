"""Samples of photos and normalised cross-correlation of many patches at once."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.pictures.features import Floats


def samples(grey: NDArray[np.uint8], columns: Floats, rows: Floats, step: int) -> Floats:
    """Bilinear samples, or with step 2 means of 2 x 2 neighbours; NaN-free: the border repeats."""
    height, width = grey.shape
    columns = np.clip(columns, 0, width - 1.001)
    rows = np.clip(rows, 0, height - 1.001)
    left, top = columns.astype(np.int32), rows.astype(np.int32)
    flat = grey.ravel()
    index = top * np.int32(width) + left
    a, b = flat.take(index).astype(np.float32), flat.take(index + 1).astype(np.float32)
    index = index + np.int32(width)
    c, d = flat.take(index).astype(np.float32), flat.take(index + 1).astype(np.float32)
    if step == 2:
        return np.asarray((a + b + c + d) * np.float32(0.25))
    x, y = columns - left, rows - top
    upper = a + (b - a) * x
    return np.asarray(upper + (c + (d - c) * x - upper) * y)


def _normalised(template: Floats) -> Floats:
    """Templates with zero mean and unit norm."""
    centred = template - template.mean(axis=(1, 2), keepdims=True)
    norm = np.sqrt((centred**2).sum(axis=(1, 2), keepdims=True))
    return np.asarray(centred / np.maximum(norm, np.float32(1e-3)))


def _window_norms(window: Floats, side: int) -> Floats:
    """Norm about the mean of every place of a template in the windows, (k, s, s)."""

    def sums(values: Floats) -> FloatArray:
        total = np.zeros((len(values), values.shape[1] + 1, values.shape[2] + 1))
        np.cumsum(np.cumsum(values, axis=1, dtype=np.float64), axis=2, out=total[:, 1:, 1:])
        return total[:, side:, side:] - total[:, :-side, side:] - total[:, side:, :-side] + total[:, :-side, :-side]

    mean = sums(window)
    square = sums(window * window)
    return np.asarray(np.sqrt(np.maximum(square - mean**2 / side**2, 1.0)), dtype=np.float32)


def correlate_wide(template: Floats, window: Floats) -> tuple[FloatArray, FloatArray]:
    """Displacement (k, 2) of the best correlation over large windows, by Fourier transforms, and its score (k,)."""
    side = template.shape[1]
    span = window.shape[1] - side + 1
    window = window - window.mean(axis=(1, 2), keepdims=True)
    size = _fast_length(window.shape[1])
    spectrum = np.fft.rfft2(window, s=(size, size)) * np.conj(np.fft.rfft2(_normalised(template), s=(size, size)))
    score = np.fft.irfft2(spectrum, s=(size, size))[:, :span, :span].astype(np.float32)
    score /= _window_norms(window, side)
    return _peaks(score, span // 2)


def correlate_near(template: Floats, window: Floats) -> tuple[FloatArray, FloatArray]:
    """Likewise over small windows, directly."""
    side = template.shape[1]
    span = window.shape[1] - side + 1
    window = window - window.mean(axis=(1, 2), keepdims=True)
    views = sliding_window_view(window, (side, side), axis=(1, 2))
    score = np.einsum("kabij,kij->kab", views, _normalised(template), optimize=True)
    score /= _window_norms(window, side)
    return _peaks(score, span // 2)


def _peaks(score: Floats, middle: int) -> tuple[FloatArray, FloatArray]:
    """The highest value of each map, with a parabola through its neighbours; a peak at the border has score 0."""
    count, side = score.shape[:2]
    best = score.reshape(count, -1).argmax(axis=1)
    row, column = best // side, best % side
    number = np.arange(count)
    value = score[number, row, column].astype(np.float64)
    inner = (row > 0) & (row < side - 1) & (column > 0) & (column < side - 1)
    r, c = np.clip(row, 1, side - 2), np.clip(column, 1, side - 2)

    def vertex(before: FloatArray, at: FloatArray, after: FloatArray) -> FloatArray:
        curve = before - 2 * at + after
        return np.clip(np.where(curve < -1e-9, (before - after) / (2 * np.minimum(curve, -1e-9)), 0.0), -0.5, 0.5)

    centre = score[number, r, c]
    x = column + vertex(score[number, r, c - 1], centre, score[number, r, c + 1])
    y = row + vertex(score[number, r - 1, c], centre, score[number, r + 1, c])
    return np.stack([x - middle, y - middle], axis=-1), np.where(inner, value, 0.0)


def _fast_length(least: int) -> int:
    """The next length of small prime factors."""
    best = 1 << (least - 1).bit_length()
    for fives in (1, 5):
        for threes in (1, 3, 9):
            length = fives * threes
            while length < least:
                length *= 2
            best = min(best, length)
    return best
