"""What of JSON Schema our AsyncAPI document uses, checked by hand: messages held to it, without another package."""

from __future__ import annotations

from typing import Any

from panoexec.mqtt.spec.asyncapi import document

DOCUMENT = document()
STRICT = True
"""What we send has no keys that the document does not name, though a consumer must bear them."""


def problems(value: Any, schema: dict[str, Any], where: str = "$") -> list[str]:
    """What of JSON Schema the document uses, and nothing else: an unknown keyword is a problem."""
    known = {"description", "default", "format", "type", "enum", "const", "anyOf", "oneOf", "$ref", "properties"}
    known |= {"required", "additionalProperties", "items", "minItems", "maxItems", "minimum", "maximum"}
    known |= {"exclusiveMaximum", "exclusiveMinimum", "minLength", "maxLength"}
    out = [f"{where}: keyword {key}" for key in set(schema) - known]
    if "$ref" in schema:
        return out + problems(value, DOCUMENT["components"]["schemas"][schema["$ref"].rpartition("/")[2]], where)
    for key in ("anyOf", "oneOf"):
        if key in schema:
            fits = sum(not problems(value, one, where) for one in schema[key])
            if fits == 0 or (key == "oneOf" and fits > 1):
                out.append(f"{where}: fits {fits} of {key}")
    if "const" in schema and value != schema["const"]:
        out.append(f"{where}: {value!r} is not {schema['const']!r}")
    if "enum" in schema and value not in schema["enum"]:
        out.append(f"{where}: {value!r} is none of {schema['enum']}")
    return out + of_type(value, schema, where)


def of_type(value: Any, schema: dict[str, Any], where: str) -> list[str]:
    kinds = {"string": str, "integer": int, "object": dict, "array": list, "boolean": bool, "null": type(None)}
    names = schema.get("type", [])
    names = [names] if isinstance(names, str) else names
    if names and not any(
        isinstance(value, (int, float) if name == "number" else kinds[name])
        and (name == "boolean" or not isinstance(value, bool))
        for name in names
    ):
        return [f"{where}: {value!r} is no {names}"]
    out = outside(value, schema, where)
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        out += [f"{where}: {name} is missing" for name in schema.get("required", []) if name not in value]
        if schema.get("additionalProperties") is False:
            out += [f"{where}: {name} is too much" for name in set(value) - set(properties)]
        elif STRICT and properties:
            out += [f"{where}: {name} is not described" for name in set(value) - set(properties)]
        for name in set(value) & set(properties):
            out += problems(value[name], properties[name], f"{where}.{name}")
    if isinstance(value, list) and "items" in schema:
        for number, item in enumerate(value):
            out += problems(item, schema["items"], f"{where}[{number}]")
    return out


def outside(value: Any, schema: dict[str, Any], where: str) -> list[str]:
    """Numbers beyond their bounds, texts and lists of a wrong length."""
    size = len(value) if isinstance(value, (str, list)) else None
    number = value if isinstance(value, (int, float)) and not isinstance(value, bool) else None
    text, items = isinstance(value, str), isinstance(value, list)
    wrong = [
        number is not None and number < schema.get("minimum", number),
        number is not None and number > schema.get("maximum", number),
        number is not None and "exclusiveMinimum" in schema and number <= schema["exclusiveMinimum"],
        number is not None and "exclusiveMaximum" in schema and number >= schema["exclusiveMaximum"],
        size is not None and text and not schema.get("minLength", 0) <= size <= schema.get("maxLength", size),
        size is not None and items and not schema.get("minItems", 0) <= size <= schema.get("maxItems", size),
    ]
    return [f"{where}: {value!r} is out of bounds"] if any(wrong) else []


def named(name: str) -> dict[str, Any]:
    return {"$ref": f"#/components/schemas/{name}"}


def misfits(channel: str, payload: Any) -> list[str]:
    """What is wrong with a message (parsed JSON; text on `status`) that was heard on a channel of the document."""
    messages = DOCUMENT["channels"][channel]["messages"]
    tried = []
    for name in messages:
        schema = DOCUMENT["components"]["messages"][name]["payload"]
        found = problems(payload, schema)
        if not found:
            return []
        tried += found
    return tried
