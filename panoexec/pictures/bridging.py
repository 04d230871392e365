"""Bridge shots: poses halfway between photos that show unmistakable things, but too little in common to be tied.

A photo from halfway between two others shares about half of its content with each. It is worth its flight where it
would show enough unmistakable corners of both: water, sky and fog have none, so nothing is bridged there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from panoexec.angles import FloatArray, rotation, wrap_180
from panoexec.optics import Camera
from panoexec.pictures.model import BridgePose

LEAST_CORNERS: Final = 20
"""Fewer unmistakable corners of either photo in the bridge are not worth a shot."""
_INSIDE: Final = 0.96
"""Share of the field of view within which a corner must be: the bridge is flown within a tolerance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bank:
    """A photo that may be bridged.

    Attributes:
        rotation: (3, 3) measured attitude, camera to plan frame.
        rays: (n, 3) directions of its unmistakable corners, camera frame, of any length.
        group: photos with the same number are tied to each other already.
    """

    rotation: FloatArray
    rays: FloatArray
    group: int


def bridge_poses(
    camera: Camera,
    banks: Mapping[int, Bank],
    *,
    tried: Collection[frozenset[int]] = (),
    pitch_deg: tuple[float, float] = (-90.0, 90.0),
    most: int,
) -> list[BridgePose]:
    """The fewest poses that may tie the groups to each other, the most promising first.

    Args:
        camera: its field of view.
        banks: photos by shot.
        tried: pairs that were bridged before.
        pitch_deg: what the gimbal reaches; a pose beyond is moved to the limit.
        most: no more poses than this.
    """
    shots = sorted(shot for shot, bank in banks.items() if len(bank.rays) >= LEAST_CORNERS)
    if len(shots) < 2:
        return []
    axes = np.array([banks[shot].rotation[:, 0] for shot in shots])
    # beyond this angle nothing that one of them shows is in a photo from halfway
    reach = 2 * np.arctan(np.hypot(camera.half_width, camera.half_height)) * 2
    near = axes @ axes.T >= np.cos(min(np.pi, reach))
    found = []
    for i, a in enumerate(shots):
        for k in range(i + 1, len(shots)):
            b = shots[k]
            if not near[i, k] or banks[a].group == banks[b].group or frozenset((a, b)) in tried:
                continue
            pose = halfway(banks[a].rotation, banks[b].rotation, pitch_deg)
            if pose is None:
                continue
            corners = min(_seen(camera, banks[shot], pose) for shot in (a, b))
            if corners >= LEAST_CORNERS:
                found.append(BridgePose(between=(a, b), pitch_deg=pose[0], yaw_deg=pose[1], corners=corners))
    found.sort(key=lambda bridge: (-bridge.corners, bridge.between))
    return _spanning(found, banks)[:most]


def halfway(first: FloatArray, second: FloatArray, pitch_deg: tuple[float, float]) -> tuple[float, float] | None:
    """Pitch and yaw, degrees, halfway between two boresights on their great circle; None if they are opposite.

    Args:
        first: attitude (3, 3), camera to plan frame.
        second: likewise.
        pitch_deg: the pose is moved to these limits.
    """
    middle = first[:, 0] + second[:, 0]
    if float(np.linalg.norm(middle)) < 1e-6:
        return None
    pitch = float(np.degrees(np.arctan2(-middle[2], np.hypot(middle[0], middle[1]))))
    # straight down, any yaw will do: the first photo's
    level = middle[:2] if float(np.hypot(middle[0], middle[1])) > 1e-6 else -first[:2, 2]
    yaw = float(np.degrees(np.arctan2(level[1], level[0])))
    return min(max(pitch, pitch_deg[0]), pitch_deg[1]), float(wrap_180(yaw))


def _seen(camera: Camera, bank: Bank, pose: tuple[float, float]) -> int:
    """How many of a photo's corners a photo with this pose shows."""
    rays = bank.rays @ (rotation(pose[1], pose[0]).T @ bank.rotation).T
    depth = rays[:, 0]
    wide = np.abs(rays[:, 1]) <= _INSIDE * camera.half_width * depth
    high = np.abs(rays[:, 2]) <= _INSIDE * camera.half_height * depth
    return int(((depth > 0) & wide & high).sum())


def _spanning(bridges: Sequence[BridgePose], banks: Mapping[int, Bank]) -> list[BridgePose]:
    """Of bridges in order, those that connect what those before them leave unconnected."""
    group = {bank.group: bank.group for bank in banks.values()}

    def root(own: int) -> int:
        while group[own] != own:
            own = group[own]
        return own

    chosen = []
    for bridge in bridges:
        one, other = (root(banks[shot].group) for shot in bridge.between)
        if one != other:
            group[one] = other
            chosen.append(bridge)
    return chosen
