"""Configurations: by name, by option, as JSON."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from panoexec.errors import UsageError
from panoexec.sim import settings
from panoexec.sim.config import SimConfig
from panoexec.sim.faults import FAULTS, parse_fault
from panoexec.sim.options import add_arguments, config_of


def test_configuration_round_trips_through_json() -> None:
    config = SimConfig(
        port=14999,
        autopilot="px4",
        scene=Path("/somewhere/scene.jpg"),
        output=Path("/somewhere"),
        faults=tuple(parse_fault(name) for name in FAULTS),
    )
    config = settings.changed(config, ["gimbal.yaw_endless=false", "gimbal.pitch.rate_deg_s=33"])
    assert settings.from_json(json.loads(json.dumps(settings.to_json(config)))) == config
    assert settings.from_json(json.loads(json.dumps(settings.to_json(SimConfig())))) == SimConfig()


def test_every_number_and_choice_can_be_set_by_its_name() -> None:
    names = settings.names(SimConfig())
    assert {"gimbal.yaw.rate_deg_s", "camera.exposure_s", "airframe.gps_wander_m", "gimbal.pitch.noise_deg"} <= set(
        names
    )
    for name, value in names.items():
        if isinstance(value, str):
            other: float | str = {"camera.files": "http", "camera.definition": "http"}[name]
        else:
            other = not value if isinstance(value, bool) else value + 1
        changed = settings.changed(SimConfig(), [f"{name}={str(other).lower()}"])
        assert settings.names(changed) == {**names, name: other}


@pytest.mark.parametrize(
    ("assignment", "complaint"),
    [
        ("gimbal.yaw.rate=3", "no such number; there are airframe.armed|no such number; there are airframe."),
        ("gimbal.yaw.rate_deg_s", "accepted is gimbal.yaw.rate_deg_s= and a number above 0"),
        ("gimbal.yaw.rate_deg_s=0", "a number above 0"),
        ("gimbal.yaw.rate_deg_s=nan", "a number above 0"),
        ("gimbal.yaw.noise_deg=-1", "a number of at least 0"),
        ("gimbal.pitch.min_deg=low", "a finite number"),
        ("gimbal.yaw_endless=perhaps", "true or false"),
        ("camera.files=ftp", "folder or http or mftp"),
    ],
)
def test_a_number_that_makes_no_sense_is_refused(assignment: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        settings.changed(SimConfig(), [assignment])


def parsed(*options: str) -> SimConfig:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return config_of(parser.parse_args(options))


def test_options_become_a_configuration() -> None:
    config = parsed("--wind", "8", "--on-ground", "--fault", "drift=0.2", "--speedup", "5", "--image-width", "320")
    assert config.airframe.wind_m_s == 8.0
    assert not config.airframe.in_air
    assert config.faults == (parse_fault("drift=0.2"),)
    assert (config.speedup, config.camera.render_width_px, config.port) == (5.0, 320, None)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--speedup", "0"], r"--speedup 0: expected more than 0 and at most 100"),
        (["--speedup", "-2"], "--speedup -2"),
        (["--speedup", "inf"], "--speedup inf"),
        (["--port", "0"], "--port 0: expected 1 to 65535"),
        (["--port", "70000"], "--port 70000"),
        (["--wind", "-1"], "--wind -1.0: expected 0 to 30 m/s"),
        (["--wind", "nan"], "--wind nan"),
        (["--image-width", "3"], "--image-width 3"),
        (["--fault", "nope"], "unknown fault 'nope'"),
    ],
)
def test_values_out_of_range_are_refused(options: list[str], complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        parsed(*options)
