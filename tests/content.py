"""Where a photo of a scene really looked, found from its content alone: for tests that compare with what is claimed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.sim.photos.scene import Scene


def expected_view(scene: Scene, camera: Camera, pose: FloatArray, width: int, height: int) -> FloatArray:
    """What a camera at a pose sees, grey levels (height, width): nearest pixels, written without the renderer."""
    focal_px = width / 2 / camera.half_width
    columns, rows = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    rays = np.stack([np.full(columns.shape, focal_px), columns, rows], axis=-1) @ pose.T
    azimuth = np.arctan2(rays[..., 1], rays[..., 0])
    elevation = np.arctan2(-rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
    h, w = scene.pixels.shape[:2]
    row = np.clip(np.floor((0.5 - elevation / np.pi) * h).astype(int), 0, h - 1)
    column = np.floor((azimuth / (2 * np.pi) + 0.5) * w).astype(int) % w
    return np.asarray(scene.pixels[row, column].mean(axis=-1))


def pointing_offset_deg(
    photo: NDArray[np.uint8], scene: Scene, camera: Camera, pose: FloatArray
) -> tuple[float, float, float]:
    """By how much a photo's content is off the claimed pose.

    Args:
        photo: (h, w, 3) uint8, of the whole field of view.
        scene: what it shows.
        camera: the camera.
        pose: claimed camera-to-world rotation (3, 3).

    Returns:
        How far the camera really looked further right and further up, degrees, to a pixel; and the height of the
        correlation's peak, 0 to 1: below about 0.1 the content is something else altogether.
    """
    height, width = photo.shape[:2]
    window = np.outer(np.hanning(height), np.hanning(width))
    pair = [photo.mean(axis=-1), expected_view(scene, camera, pose, width, height)]
    seen, expected = (np.fft.rfft2((p - p.mean()) / max(p.std(), 1.0) * window) for p in pair)
    cross = expected * np.conj(seen)
    correlation = np.fft.irfft2(cross, s=(height, width))
    energy = np.sqrt(_energy(seen, width) * _energy(expected, width))
    peak = np.unravel_index(np.argmax(correlation), correlation.shape)
    down = (int(peak[0]) + height // 2) % height - height // 2
    right = (int(peak[1]) + width // 2) % width - width // 2
    degrees = np.degrees(2 * camera.half_width / width)
    score = float(correlation[peak] * height * width / energy)
    return float(right * degrees), float(-down * degrees), score


def _energy(spectrum: NDArray[np.complex128], width: int) -> float:
    power = np.abs(spectrum) ** 2
    doubled = power[:, 1 : (width + 1) // 2].sum()
    return float(power.sum() + doubled)
