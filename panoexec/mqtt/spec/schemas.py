"""JSON Schemas of documents that no payload model describes: what dataclasses are written as, plans, answers' data."""

from __future__ import annotations

import dataclasses
import types
import typing
from enum import Enum, IntEnum
from typing import Any, Final

from panoexec.inputs.plan_file import FORMAT
from panoexec.inputs.plan_options import constraints_schema
from panoexec.planning.model import Certificate, Estimate, Shot

_NUMBER: Final = {"type": "number"}
_WHOLE: Final = {"type": "integer"}
_TEXT: Final = {"type": "string"}
_PAIR: Final = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}
_NULL: Final = {"type": "null"}
_PARTS: Final = "#/components/schemas/"


def part_schemas() -> dict[str, dict[str, Any]]:
    """What the other schemas refer to, by name."""
    return {
        "Camera": _camera(),
        "Certificate": schema_of_dataclass(Certificate) | {"description": "The certificate of a plan."},
        "Estimate": schema_of_dataclass(Estimate) | {"description": "Estimated duration and size of a plan."},
    }


def schema_of_dataclass(cls: Any) -> dict[str, Any]:
    """The schema of what `panoexec.codec.encode`, or `dataclasses.asdict`, makes of a dataclass."""
    hints = typing.get_type_hints(cls)
    return _object({field.name: _of_type(hints[field.name]) for field in dataclasses.fields(cls)})


def plan_schema() -> dict[str, Any]:
    """Of a plan file (`panoexec.inputs.plan_file.plan_to_data`)."""
    return _object(
        {
            "format": {"const": FORMAT},
            "method": _TEXT,
            "camera": _part("Camera"),
            "constraints": constraints_schema(),
            "shots": {"type": "array", "items": schema_of_dataclass(Shot), "minItems": 1},
            "certificate": _or_null(_part("Certificate")),
            "estimate": _or_null(_part("Estimate")),
            "lower_bound": {"type": ["integer", "null"]},
            "notes": {"type": "array", "items": _TEXT},
        }
    )


def _camera() -> dict[str, Any]:
    """Of a camera (`panoexec.inputs.plan_file.camera_to_data`)."""
    out = _object(
        {
            "name": _TEXT,
            "sensor_width_mm": _NUMBER,
            "sensor_height_mm": _NUMBER,
            "image_width_px": _WHOLE,
            "image_height_px": _WHOLE,
            "focal_length_mm": _NUMBER,
            "hfov_deg": _NUMBER,
            "vfov_deg": _NUMBER,
        }
    )
    out["properties"]["calibrated_focal_length_mm"] = _NUMBER
    return out | {"description": "A camera with its field of view."}


def answer_schemas(state: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The `data` of each command's answer.

    Args:
        state: the schema of a state.
    """
    planned = {
        "images": _WHOLE,
        "rows": _WHOLE,
        "duration_s": {"type": ["number", "null"]},
        "estimate": _or_null(_part("Estimate")),
        "certificate": _or_null(_part("Certificate")),
        "camera": _part("Camera"),
        "lower_bound": {"type": ["integer", "null"]},
        "notes": {"type": "array", "items": _TEXT},
    }
    mission = {"mission_id": {"type": ["string", "null"]}}
    now = _object(mission | {"state": _TEXT})
    # a mission that does not fly yet, or any more, has no state to tell
    perhaps_now = _object(mission)
    perhaps_now["properties"] = mission | {"state": _TEXT}
    shot = _object({"shot": _WHOLE} | mission | {"state": _TEXT})
    return {
        "plan": _object(planned),
        "start": _object(mission | planned),
        "pause": now,
        "resume": perhaps_now,
        "abort": perhaps_now,
        "finish": now,
        "skip": shot,
        "repeat": shot,
        "get": state,
        "set_profile": _object({"camera": _part("Camera")}),
    }


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _part(name: str) -> dict[str, Any]:
    return {"$ref": _PARTS + name}


def _or_null(schema: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [schema, _NULL]}


def _of_type(hint: Any) -> dict[str, Any]:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in {types.UnionType, typing.Union}:
        return {"anyOf": [_of_type(arg) for arg in args]}
    if origin is tuple:
        open_end = len(args) == 2 and args[1] is Ellipsis
        size = {} if open_end else {"minItems": len(args), "maxItems": len(args)}
        return {"type": "array", "items": _of_type(args[0])} | size
    if dataclasses.is_dataclass(hint):
        return schema_of_dataclass(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"type": "string", "enum": [_written(member) for member in hint]}
    # NaN and infinity are written as null
    names = {float: ["number", "null"], int: "integer", str: "string", bool: "boolean", type(None): "null"}
    return {"type": names[hint]}


def _written(member: Enum) -> str:
    return member.name.lower() if isinstance(member, IntEnum) else str(member.value)
