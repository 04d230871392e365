"""Presets: requests with a name, kept in the configuration (`[presets.NAME]`)."""

from __future__ import annotations

import re
from typing import Any, Final, TypeVar

from pydantic import ValidationError

from panoexec.inputs.config import Config
from panoexec.inputs.validation import problem_lines
from panoexec.mqtt.answers import PresetFields
from panoexec.mqtt.requests import PlanRequest, RefusedRequestError, StartRequest
from panoexec.suggestions import did_you_mean

R = TypeVar("R", bound=PlanRequest)

_ID: Final = re.compile(r"[A-Za-z0-9_-]{1,40}")
_MOST: Final = 50
_NOT_HERE: Final = frozenset({"transaction", "preset", "plan", "shots"})
_OVERLAPS: Final = frozenset({"overlap", "overlap_h", "overlap_v"})
_OF_A_PLAN: Final = frozenset(
    {
        "camera",
        "lens",
        "elevation_deg",
        "azimuth_deg",
        "guarantee",
        "method",
        "order",
        "budget_s",
        "textured_below",
        *_OVERLAPS,
    }
)
"""What a plan file in the request says itself."""


def preset_problems(config: Config) -> list[str]:
    """What is wrong with the presets of a configuration, one line each."""
    problems = []
    if len(config.presets) > _MOST:
        problems.append(f"presets: there are {len(config.presets)}, at most {_MOST} can be kept")
    if config.rc.preset is not None and config.rc.preset not in config.presets:
        problems.append(f"rc.preset: there is no [presets.{config.rc.preset}]")
    if config.stations.enabled and not config.presets:
        problems.append("stations.enabled: there is no [presets.NAME], whose number a station could have")
    for name, fields in config.presets.items():
        if not _ID.fullmatch(name):
            problems.append(f"presets.{name}: {name!r} is not an id: use 1 to 40 of A-Z a-z 0-9 _ -")
        wrong = _NOT_HERE & fields.keys()
        problems += [f"presets.{name}.{key} is not a key of a preset" for key in sorted(wrong)]
        known = {key: value for key, value in fields.items() if key not in wrong}
        try:
            StartRequest.model_validate({"transaction": 0, **known})
        except ValidationError as error:
            problems += [f"presets.{name}.{line}" for line in problem_lines(error, StartRequest)]
    return problems


def with_preset(config: Config, request: R) -> R:
    """A request with the fields of its preset, where it does not say otherwise itself.

    Raises:
        RefusedRequestError: there is no such preset.
    """
    if request.preset is None:
        return request
    fields = config.presets.get(request.preset)
    if fields is None:
        near = did_you_mean(request.preset, config.presets.keys(), quoted=True)
        known = ", ".join(sorted(config.presets)) or "none is configured"
        hint = f": {near}" if near else f"; presets: {known}"
        raise RefusedRequestError("invalid", f"there is no preset {request.preset!r}{hint}", field="preset")
    own = {name: getattr(request, name) for name in request.model_fields_set}
    own = {name: value for name, value in own.items() if value is not None}
    overridden = set(own) | (_OVERLAPS if _OVERLAPS & own.keys() else set()) | (_OF_A_PLAN if "plan" in own else set())
    if "tolerance_deg" in own and "tolerance_deg" in fields:
        stated = own["tolerance_deg"].model_dump(exclude_none=True)
        own["tolerance_deg"] = {**fields["tolerance_deg"], **stated}
    kept = {
        name: value for name, value in fields.items() if name not in overridden and name in type(request).model_fields
    }
    return type(request).model_validate(kept | own)


def presets_document(config: Config) -> list[dict[str, Any]]:
    """The presets for an answer, in the order of the configuration."""
    return [
        PresetFields(
            preset=name,
            name=str(fields.get("name", name)),
            fields={key: value for key, value in fields.items() if key != "name"},
        ).model_dump(mode="json")
        for name, fields in config.presets.items()
    ]
