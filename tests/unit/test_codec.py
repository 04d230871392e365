"""Dataclasses to JSON and back: the rules that stored files depend on."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Annotated, Any, Literal

import pytest

from panoexec.codec import ByName, Flag, Number, Whole, decode, encode


class Level(IntEnum):
    LOW_ONE = 3
    HIGH = 5


class Mode(Enum):
    FAST = "fast"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    size: Number
    text: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    count: Whole
    flag: Flag
    level: Annotated[Level, ByName()]
    mode: Mode
    kind: Literal["a", "b"]
    pair: tuple[Number, Number]
    parts: tuple[Part, ...]
    maybe: Number | None = None
    inner: Part | None = None


VALUE = Thing(
    count=2,
    flag=True,
    level=Level.LOW_ONE,
    mode=Mode.FAST,
    kind="a",
    pair=(1.5, math.inf),
    parts=(Part(size=math.nan, text="\udc80"),),
)
DOCUMENT = {
    "count": 2,
    "flag": True,
    "level": "low_one",
    "mode": "fast",
    "kind": "a",
    "pair": [1.5, None],
    "parts": [{"size": None, "text": "\udc80"}],
    "maybe": None,
    "inner": None,
}


def test_nan_and_infinity_are_null_and_enums_are_names_or_values() -> None:
    assert encode(VALUE) == DOCUMENT
    assert json.loads(json.dumps(encode(VALUE), allow_nan=False)) == DOCUMENT


def test_null_is_nan_and_only_where_a_number_belongs() -> None:
    found = decode(Thing, DOCUMENT | {"of a later version": 1})
    assert (found.count, found.flag, found.level, found.mode, found.kind) == (2, True, Level.LOW_ONE, Mode.FAST, "a")
    assert found.pair[0] == 1.5
    assert math.isnan(found.pair[1])
    assert math.isnan(found.parts[0].size)
    assert found.parts[0].text == "\udc80", "a file name that is no UTF-8"
    assert found.maybe is None
    assert found.inner is None


def test_whole_numbers_are_floats_where_one_belongs() -> None:
    found = decode(Part, {"size": 3})
    assert isinstance(found.size, float)


@pytest.mark.parametrize(
    ("key", "wrong"),
    [
        ("count", "2"),
        ("count", 2.0),
        ("count", True),
        ("count", None),
        ("flag", 1),
        ("flag", "true"),
        ("level", "medium"),
        ("level", 3),
        ("level", None),
        ("mode", "slow"),
        ("kind", "c"),
        ("pair", [1.0]),
        ("pair", [1.0, 2.0, 3.0]),
        ("pair", 1.0),
        ("pair", ["x", 1.0]),
        ("parts", [{}]),
        ("parts", [3]),
        ("parts", None),
        ("maybe", "x"),
        ("inner", 3),
    ],
)
def test_a_wrong_type_is_a_value_error_of_one_line(key: str, wrong: Any) -> None:
    with pytest.raises(ValueError, match=f"^not a Thing: {key}[^\n]*$"):
        decode(Thing, DOCUMENT | {key: wrong})


@pytest.mark.parametrize("key", ["count", "flag", "level", "mode", "kind", "pair", "parts"])
def test_what_is_missing_is_a_value_error(key: str) -> None:
    with pytest.raises(ValueError, match=f"^not a Thing: {key}: "):
        decode(Thing, {name: value for name, value in DOCUMENT.items() if name != key})


@pytest.mark.parametrize("document", [None, [], "text", 3])
def test_what_is_no_object_is_a_value_error(document: Any) -> None:
    with pytest.raises(ValueError, match=r"^not a Part: "):
        decode(Part, document)


@pytest.mark.parametrize("module", ["panoexec", "panoexec.__main__", "panoexec.sim.settings", "panoexec.sim.options"])
def test_what_does_not_need_it_does_not_import_pydantic(module: str) -> None:
    program = f"import sys, {module}; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
