"""Which of several gimbals is used, and whose attitude counts."""

from __future__ import annotations

import pytest

from panoexec.adapters.gimbal.gimbal_choice import (
    Candidate,
    component_of,
    in_order,
    is_gimbal,
    source_for,
    with_unlisted,
)
from panoexec.errors import DeviceError

OWN = Candidate(gimbal_id=1, manager=154, device_id=154, vendor="Gremsy")
FIRST = Candidate(gimbal_id=2, manager=1, device_id=1)
SECOND = Candidate(gimbal_id=3, manager=1, device_id=2)


def test_the_autopilots_manager_comes_first() -> None:
    assert in_order([OWN, SECOND, FIRST]) == [FIRST, SECOND, OWN]


def test_the_configuration_excludes_the_others() -> None:
    assert in_order([OWN, SECOND, FIRST], manager=154) == [OWN]
    assert in_order([OWN, SECOND, FIRST], device=2) == [SECOND]
    assert in_order([OWN, SECOND, FIRST], device=171) == [SECOND]
    assert in_order([OWN, SECOND, FIRST], device=154) == [FIRST, OWN]
    assert in_order([OWN, SECOND, FIRST], manager=1, device=1) == [FIRST]
    assert in_order([OWN, FIRST], manager=42) == []


@pytest.mark.parametrize(("device_id", "component"), [(0, 154), (1, 154), (2, 171), (6, 175), (154, 154), (42, 42)])
def test_a_device_id_tells_a_component(device_id: int, component: int) -> None:
    assert component_of(device_id) == component


def test_only_gimbals_tell_attitudes_of_gimbals() -> None:
    assert all(is_gimbal(component, {}) for component in (1, 154, 171, 175))
    assert not is_gimbal(155, {})
    assert not is_gimbal(155, {155: 18})
    assert is_gimbal(155, {155: 26})


@pytest.mark.parametrize(
    ("device_id", "heard", "device", "source"),
    [
        (1, [1, 154], 0, 154),
        (1, [1, 154, 155, 171], 0, 154),
        (2, [1, 154, 171], 0, 171),
        (1, [1], 0, 1),
        (1, [1, 155], 0, 1),
        (2, [1, 154], 0, 1),
        (1, [155], 0, 155),
        (154, [1, 154], 0, 154),
        (1, [1, 154, 155], 155, 155),
        (1, [1, 154], 1, 154),
    ],
)
def test_the_source_is_the_component_of_the_pointed_device(
    device_id: int, heard: list[int], device: int, source: int
) -> None:
    assert source_for(device_id, heard, device=device) == source


@pytest.mark.parametrize(
    ("device_id", "heard", "device", "why"),
    [
        (154, [1, 155], 0, r"no attitude comes from gimbal device 154 \(heard: component 1, 155\)"),
        (1, [155, 171], 0, "set \\[gimbal\\] device if another is meant"),
        (1, [], 0, "none was heard"),
        (1, [1, 154], 155, r"\[gimbal\] device = 155, but no attitude comes from it"),
    ],
)
def test_what_cannot_be_the_gimbal_is_not_taken_for_it(device_id: int, heard: list[int], device: int, why: str) -> None:
    with pytest.raises(DeviceError, match=why):
        source_for(device_id, heard, device=device)


def test_the_autopilots_manager_is_offered_though_mavsdk_lists_only_that_of_the_gimbal() -> None:
    (unlisted,) = [one for one in with_unlisted([OWN], [(1, 154), (154, 154)]) if one != OWN]
    assert (unlisted.manager, unlisted.device_id, unlisted.vendor) == (1, 154, "Gremsy")
    assert unlisted.gimbal_id < 0
    assert in_order([OWN, unlisted])[0] == unlisted
    assert with_unlisted([FIRST, OWN], [(1, 1), (154, 154)]) == [FIRST, OWN]
    assert with_unlisted([OWN], [(1, 0), (42, 154)]) == [OWN], "no device that was listed, or another's manager"
