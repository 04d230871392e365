"""JSON Schemas of what panoexec writes: events, plans, answers' data; derived from the dataclasses and models."""

from __future__ import annotations

from typing import Any, Final

from pydantic import BaseModel, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from panoexec.mqtt.answers import ANSWERS, CameraFields, PlanFields
from panoexec.mqtt.messages import State
from panoexec.planning.model import Certificate, Estimate

_PARTS: Final = "#/components/schemas/"
_NAMED: Final = {"CameraFields": "Camera", "Certificate": "Certificate", "Estimate": "Estimate"}
"""What other schemas refer to by name; everything else stands where it is used."""


class _AsWritten(GenerateJsonSchema):
    """Schemas of documents that panoexec writes, rather than of those that it would accept."""

    def float_schema(self, schema: core_schema.FloatSchema) -> JsonSchemaValue:
        """NaN and infinity are written as null."""
        return {"type": "number" if schema.get("allow_inf_nan") is False else ["number", "null"]}

    def tuple_schema(self, schema: core_schema.TupleSchema) -> JsonSchemaValue:
        """A tuple has items of one kind, and a length if that is fixed."""
        items = schema["items_schema"]
        size = {} if schema.get("variadic_item_index") is not None else {"minItems": len(items), "maxItems": len(items)}
        out: JsonSchemaValue = {"type": "array", "items": self.generate_inner(items[0])} | size
        if "min_length" in schema:
            out["minItems"] = schema["min_length"]
        return out

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        """What a reader would assume does not matter."""
        return self.generate_inner(schema["schema"])

    def field_is_required(
        self, field: core_schema.ModelField | core_schema.DataclassField | core_schema.TypedDictField, total: bool
    ) -> bool:
        """Every field of a dataclass is written."""
        return field["type"] == "dataclass-field" or super().field_is_required(field, total)

    def sort(self, value: JsonSchemaValue, parent_key: str | None = None) -> JsonSchemaValue:  # noqa: ARG002  (pydantic's)
        """Fields stay in the order in which they are written."""
        return value


def schema_of(kind: Any) -> dict[str, Any]:
    """The schema of what `panoexec.codec.encode`, or the model's dump, makes of a dataclass or a model."""
    schema = TypeAdapter(kind).json_schema(
        mode="serialization", schema_generator=_AsWritten, ref_template=_PARTS + "{model}"
    )
    parts = schema.pop("$defs", {})
    resolved: dict[str, Any] = _resolved(schema, parts)
    return resolved


def part_schemas() -> dict[str, dict[str, Any]]:
    """What the other schemas refer to, by name."""
    kinds: dict[str, tuple[Any, str]] = {
        "Camera": (CameraFields, "A camera with its field of view."),
        "Certificate": (Certificate, "What is proven of a plan."),
        "Estimate": (Estimate, "What a plan will take."),
    }
    return {name: schema_of(kind) | {"description": text} for name, (kind, text) in kinds.items()}


def plan_schema() -> dict[str, Any]:
    """Of a plan file (`panoexec.inputs.plan_file.plan_to_data`)."""
    return schema_of(PlanFields)


def answer_schemas() -> dict[str, dict[str, Any]]:
    """The `data` of each command's answer."""
    return {command: _answer(model) for command, model in ANSWERS.items()}


def _answer(model: type[BaseModel]) -> dict[str, Any]:
    return {"$ref": f"{_PARTS}State"} if model is State else schema_of(model)


def _resolved(value: Any, parts: dict[str, Any]) -> Any:
    """The schema without references to parts that have no name, without titles, with one line of description.

    What an enum means stands in the document once, not in every event.
    """
    if isinstance(value, list):
        return [_resolved(item, parts) for item in value]
    if not isinstance(value, dict):
        return value
    if "$ref" in value:
        name = str(value["$ref"]).removeprefix(_PARTS)
        return {"$ref": _PARTS + _NAMED[name]} if name in _NAMED else _resolved(parts[name], parts)
    out = {key: _resolved(item, parts) for key, item in value.items() if key != "title"}
    if isinstance(text := out.get("description"), str):
        out["description"] = text.partition("\n")[0]
        if "enum" in out:
            del out["description"]
    return out
