"""Who pans, from the configuration to the limits that plan and mission go by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from panoexec.daemon.mission_request import configuration_problems, gimbal_limits, settings_of, wish_of
from panoexec.inputs.config import Config
from panoexec.mission.preflight import effective_limits
from panoexec.mqtt.requests import PlanRequest
from panoexec.planning.model import GimbalLimits, Turning


def config(**gimbal: Any) -> Config:
    return Config.model_validate(
        {"gimbal": gimbal, "vehicle": {"connection": "udpin://0.0.0.0:1", "yaw_rate_deg_s": 30}}
    )


def test_by_default_the_vehicle_is_never_turned() -> None:
    assert gimbal_limits(config()).turning is None
    assert gimbal_limits(config(yaw_deg=[-160, 160])).turning is None


def test_a_vehicle_that_pans_leaves_the_gimbal_no_pan_range() -> None:
    limits = gimbal_limits(config(yaw="vehicle", yaw_deg=[-160, 160], pitch_deg=[-90, 20]))
    assert (limits.yaw_min_deg, limits.yaw_max_deg, limits.yaw_endless, limits.pans) == (0.0, 0.0, False, False)
    assert limits.pitch_max_deg == 20
    assert limits.turning == Turning(rate_deg_s=30.0, acceleration_deg_s2=90.0)
    # what the gimbal states of its pan axis does not count then, what it states of its pitch does
    own = GimbalLimits(pitch_min_deg=-120.0, pitch_max_deg=40.0)
    held = effective_limits(own, limits)
    assert (held.pitch_min_deg, held.pitch_max_deg, held.pans) == (-120.0, 40.0, False)


def test_auto_keeps_the_pan_range_that_is_stated_else_the_configured_one() -> None:
    limits = gimbal_limits(config(yaw="auto", yaw_deg=[-160, 160]))
    assert (limits.yaw_min_deg, limits.yaw_max_deg, limits.all_round) == (-160.0, 160.0, True)
    own = GimbalLimits(yaw_min_deg=0.0, yaw_max_deg=0.0, yaw_endless=False)
    held = effective_limits(own, limits)
    assert not held.pans
    assert held.turning == limits.turning


@pytest.mark.parametrize("yaw", ["vehicle", "auto"])
def test_it_is_no_problem_of_a_configuration_and_reaches_the_mission(yaw: str, tmp_path: Path) -> None:
    del tmp_path
    wanted = config(yaw=yaw)
    assert configuration_problems(wanted) == []
    settings = settings_of(wanted, wish_of(wanted, PlanRequest(transaction="t")))
    assert settings.gimbal.turning is not None
