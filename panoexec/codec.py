"""Frozen dataclasses to JSON objects and back, for values that panoexec itself wrote (journal, events, manifest).

Checked just enough to refuse what does not fit; files that people write are checked by their own modules.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from enum import Enum, IntEnum
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")


def encode(value: Any) -> dict[str, Any]:
    """A dataclass as a JSON object: tuples become lists, numbered enums their names in lower case.

    NaN becomes null, and so does infinity, which is read as NaN.
    """
    return {f.name: _encode(getattr(value, f.name)) for f in dataclasses.fields(value)}


def decode(cls: type[T], data: Mapping[str, Any]) -> T:
    """The dataclass that `encode` wrote; keys that it does not know are ignored.

    Raises:
        ValueError: something is missing, or of another type.
    """
    hints = _hints(cls)  # type: ignore[arg-type]  # a class is hashable
    try:
        return cls(**{name: _decode(hint, data[name]) for name, hint in hints.items() if name in data})
    except (TypeError, KeyError) as error:
        raise ValueError(f"not a {cls.__name__}: {error}") from error


@cache
def _hints(cls: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    return {f.name: hints[f.name] for f in dataclasses.fields(cls)}


def _encode(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return encode(value)
    if isinstance(value, tuple | list):
        return [_encode(item) for item in value]
    if isinstance(value, IntEnum):
        return value.name.lower()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _decode(hint: Any, value: Any) -> Any:
    if typing.get_origin(hint) is not None:
        return _decode_generic(hint, value)
    if hint is float:
        return math.nan if value is None else float(value)
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return hint[str(value).upper()]
    if dataclasses.is_dataclass(hint):
        return decode(typing.cast("type[Any]", hint), value)
    if hint in {str, int, bool} and type(value) is not hint:
        raise TypeError(f"expected {hint.__name__}, got {value!r}")
    return hint(value)


def _decode_generic(hint: Any, value: Any) -> Any:
    origin = typing.get_origin(hint)
    if origin in {types.UnionType, typing.Union}:
        inner = next(arg for arg in typing.get_args(hint) if arg is not type(None))
        return None if value is None else _decode(inner, value)
    if origin is tuple:
        args = typing.get_args(hint)
        kinds = [args[0]] * len(value) if len(args) == 2 and args[1] is Ellipsis else args
        return tuple(_decode(kind, item) for kind, item in zip(kinds, value, strict=True))
    if origin is typing.Literal and value in typing.get_args(hint):
        return value
    raise ValueError(f"{value!r} is no {hint}")
