"""Which gimbal is used: its manager, and the MAVLink component whose attitude counts. Pure; daemon and doctor use it.

A vehicle may have several gimbals, and a gimbal may be a manager as well as the autopilot that drives it. The
autopilot's manager comes first, because others are refused while it drives the gimbal. A gimbal device id of 7 or more
is the device's own component (GIMBAL_MANAGER_INFORMATION, 280); 1 to 6 number the gimbals that an autopilot drives
itself, and ArduPilot forwards those that have a component of their own: the first from 154, further ones from 171 on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.errors import DeviceError

MAV_TYPE_GIMBAL: Final = 26
FIRST_GIMBAL: Final = 154
SECOND_GIMBAL: Final = 171
LAST_GIMBAL: Final = 175
"""MAV_COMP_ID_GIMBAL, MAV_COMP_ID_GIMBAL2 and MAV_COMP_ID_GIMBAL6."""
FIRST_COMPONENT_ID: Final = 7
"""Gimbal device ids from here on are components."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A gimbal as a manager offers it.

    Attributes:
        gimbal_id: its id in MAVSDK, from 1; negative if MAVSDK does not list its manager.
        manager: MAVLink component of the manager.
        device_id: its gimbal device id.
        vendor, model: as reported, or "".
    """

    gimbal_id: int
    manager: int
    device_id: int
    vendor: str = ""
    model: str = ""

    @property
    def name(self) -> str:
        """For display."""
        return f"{self.vendor} {self.model}".strip() or "unnamed"

    def describe(self) -> str:
        """For messages: name, manager and device."""
        return f"{self.name} (manager {self.manager}, device {self.device_id})"


def component_of(device_id: int) -> int:
    """The component of a gimbal device that speaks for itself."""
    if device_id >= FIRST_COMPONENT_ID:
        return device_id
    return FIRST_GIMBAL if device_id <= 1 else SECOND_GIMBAL + device_id - 2


def in_order(candidates: Iterable[Candidate], *, manager: int = 0, device: int = 0) -> list[Candidate]:
    """The gimbals that may be used, the first choice first: the autopilot's, then by manager and device.

    Args:
        candidates: all that were found.
        manager: component of the only manager that may be used; 0: any.
        device: component or device id of the only gimbal that may be used; 0: any.
    """
    fitting = [
        one
        for one in candidates
        if manager in (0, one.manager) and (device in (0, one.device_id) or device == component_of(one.device_id))
    ]
    return sorted(fitting, key=lambda one: (one.manager != AUTOPILOT, one.manager, one.device_id))


def with_unlisted(listed: Sequence[Candidate], told: Iterable[tuple[int, int]]) -> list[Candidate]:
    """The gimbals with those of the autopilot's manager that MAVSDK does not list.

    MAVSDK lists one manager for a device id: where a gimbal is a manager itself, that may be the gimbal's.

    Args:
        listed: by MAVSDK.
        told: manager and device id of each GIMBAL_MANAGER_INFORMATION (280) that came.
    """
    known = {(one.manager, one.device_id) for one in listed}
    named = {one.device_id: one for one in listed}
    return [
        *listed,
        *(
            Candidate(
                gimbal_id=-device_id,
                manager=manager,
                device_id=device_id,
                vendor=named[device_id].vendor,
                model=named[device_id].model,
            )
            for manager, device_id in sorted(set(told) - known)
            if manager == AUTOPILOT and device_id in named
        ),
    ]


def is_gimbal(component: int, types: Mapping[int, int]) -> bool:
    """Whether a component may tell the attitude of a gimbal: the autopilot, or one that says that it is a gimbal.

    Args:
        component: MAVLink's number of it.
        types: MAV_TYPE by component, of those that send heartbeats.
    """
    known = component in (AUTOPILOT, FIRST_GIMBAL) or SECOND_GIMBAL <= component <= LAST_GIMBAL
    return known or types.get(component) == MAV_TYPE_GIMBAL


def source_for(device_id: int, heard: Sequence[int], *, device: int = 0) -> int:
    """The component whose attitude reports count for a gimbal.

    Args:
        device_id: gimbal device id in the manager's messages.
        heard: components that tell an attitude of a gimbal, of late.
        device: the configured component or device id; 0: automatic.

    Raises:
        DeviceError: none that could be it; the message names those that were heard.
    """
    own = device if device >= FIRST_COMPONENT_ID else component_of(device_id)
    if own in heard:
        return own
    others = sorted(set(heard) - {AUTOPILOT})
    if device >= FIRST_COMPONENT_ID:
        raise DeviceError(f"[gimbal] device = {device}, but no attitude comes from it ({_named(heard)})")
    if device_id < FIRST_COMPONENT_ID and AUTOPILOT in heard:
        return AUTOPILOT
    if device_id <= 1 and len(others) == 1:
        return others[0]
    raise DeviceError(
        f"no attitude comes from gimbal device {device_id} ({_named(heard)}): set [gimbal] device if another is meant"
    )


def _named(heard: Sequence[int]) -> str:
    return f"heard: component {', '.join(map(str, sorted(heard)))}" if heard else "none was heard"
