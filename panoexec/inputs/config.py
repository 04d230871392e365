"""The configuration of the daemon, read from a TOML file and environment variables and validated.

Every key can be overridden by `PANOEXEC_<SECTION>__<KEY>`, which is parsed as a TOML value if possible and is a string
otherwise. Unknown keys, values out of range and impossible combinations are errors; all are reported at once. Secrets
are not part of the configuration, only the paths of their files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from panoexec.errors import InputFileError
from panoexec.inputs.sections import Section
from panoexec.inputs.service_sections import LogSection, MqttSection, StorageSection, WebSection
from panoexec.inputs.validation import problem_lines, read_toml
from panoexec.inputs.vehicle_sections import (
    CameraSection,
    GimbalSection,
    GuardsSection,
    MissionSection,
    PicturesSection,
    PointingSection,
    RcSection,
    StationsSection,
    VehicleSection,
)

ENV_PREFIX = "PANOEXEC_"
TURNING_MODES = frozenset({"OFFBOARD", "HOLD"})
"""Flight modes, by MAVSDK's names, in which ArduPilot (OFFBOARD) or PX4 (HOLD) executes yaw commands."""


class Config(Section):
    """The complete configuration."""

    vehicle: VehicleSection = VehicleSection()
    gimbal: GimbalSection = GimbalSection()
    camera: CameraSection = CameraSection()
    pointing: PointingSection = PointingSection()
    guards: GuardsSection = GuardsSection()
    pictures: PicturesSection = PicturesSection()
    mission: MissionSection = MissionSection()
    mqtt: MqttSection = MqttSection()
    storage: StorageSection = StorageSection()
    web: WebSection = WebSection()
    rc: RcSection = RcSection()
    stations: StationsSection = StationsSection()
    log: LogSection = LogSection()
    presets: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Requests with a name; `panoexec.daemon.presets` checks them by the model of the request."""

    @model_validator(mode="after")
    def _a_vehicle_that_pans_may_be_turned(self) -> Self:
        modes = self.guards.allowed_modes
        if self.gimbal.yaw != "gimbal" and modes and not set(modes) & TURNING_MODES:
            raise ValueError(
                f'gimbal.yaw = "{self.gimbal.yaw}" turns the vehicle, but guards.allowed_modes = {list(modes)} has no '
                f"mode in which it can be turned: OFFBOARD (ArduPilot: GUIDED) or HOLD (PX4)"
            )
        return self


def load_config(path: Path, environment: Mapping[str, str]) -> Config:
    """Read and check a configuration.

    Args:
        path: the TOML file.
        environment: environment variables; `PANOEXEC_<SECTION>__<KEY>` override the file.

    Raises:
        InputFileError: the file or an overriding variable is invalid; the error lists every problem.
    """
    if not path.exists():
        copy = "config/panoexec.toml of a clone or /usr/share/panoexec/config.toml of the package"
        raise InputFileError(str(path), [f"cannot be read: there is no such file; copy {copy}"])
    tables = read_toml(path)
    problems = _apply_environment(tables, environment)
    try:
        config = Config.model_validate(tables)
    except ValidationError as error:
        raise InputFileError(str(path), problems + problem_lines(error, Config)) from error
    if problems:
        raise InputFileError(str(path), problems)
    return config


def _apply_environment(tables: dict[str, Any], environment: Mapping[str, str]) -> list[str]:
    """Put overriding variables into the tables; returns the problems of their names."""
    problems: list[str] = []
    for name, text in sorted(environment.items()):
        if not name.startswith(ENV_PREFIX) or "__" not in name:
            continue
        section, _, key = name.removeprefix(ENV_PREFIX).lower().partition("__")
        if section not in Config.model_fields:
            known = ", ".join(sorted(Config.model_fields))
            problems.append(f"environment variable {name}: unknown section {section!r}; sections are {known}")
            continue
        table = tables.setdefault(section, {})
        if isinstance(table, dict):
            table[key] = _toml_value(text)
    return problems


def _toml_value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
