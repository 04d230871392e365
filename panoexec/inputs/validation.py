"""Validation errors of pydantic as lines of text: the key, the value, and what is accepted."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from panoexec.errors import InputFileError
from panoexec.suggestions import did_you_mean, nearest

MOST_PROBLEMS = 50
"""Lines; requests of strangers have up to 10 000 problems."""
_LONGEST_VALUE = 60


def problem_lines(error: ValidationError, model: type[BaseModel] | None = None) -> list[str]:
    """One line for each problem: `key: value is wrong because …`; beyond `MOST_PROBLEMS`, how many more there are.

    Args:
        error: the problems.
        model: what was validated: unknown keys get the known one that is nearest.
    """
    problems = error.errors(include_url=False)
    # of items that are wrong pydantic also says that they are too few
    inside = {problem["loc"][:depth] for problem in problems for depth in range(len(problem["loc"]))}
    problems = [one for one in problems if one["type"] != "too_short" or one["loc"] not in inside]
    lines = [_line(dict(problem), model) for problem in problems[:MOST_PROBLEMS]]
    more = len(problems) - len(lines)
    return [*lines, f"and {more} more problems"] if more else lines


def _line(problem: dict[str, Any], model: type[BaseModel] | None) -> str:
    key = dotted(problem["loc"]) or "the document"
    kind = problem["type"]
    if kind == "missing":
        return f"{key} is missing{_instead(problem, model)}"
    if kind == "extra_forbidden":
        return f"{key} is not a known key{_hint(problem['loc'], model)}"
    if kind == "value_error":
        # raised by validators of panoexec, whose text is complete
        text = str(problem["ctx"]["error"])
        return f"{key}: {text}" if problem["loc"] else text
    message = str(problem["msg"])
    return f"{key} is {shown(problem['input'])}: {message[:1].lower()}{message[1:]}"


def _instead(problem: dict[str, Any], model: type[BaseModel] | None) -> str:
    """The unknown key that was given for a missing one, where unknown keys are no errors; "" if none is near."""
    location, given = problem["loc"], problem["input"]
    models = _models_at(location[:-1], model)
    if not isinstance(given, dict) or any(one.model_config.get("extra") == "forbid" for one in models):
        return ""
    known = {field.alias or name for one in models for name, field in one.model_fields.items()}
    strange = [name for name in given if isinstance(name, str) and name not in known]
    near = nearest(str(location[-1]), strange, cutoff=0.8)
    return f": is {' or '.join(one[:_LONGEST_VALUE] for one in near)} meant?" if near else ""


def _models_at(location: tuple[int | str, ...], model: type[BaseModel] | None) -> list[type[BaseModel]]:
    """The models that validate what is at a place in a document."""
    models = [model] if model is not None else []
    for part in location:
        if isinstance(part, str):
            fields = [one.model_fields[part] for one in models if part in one.model_fields]
            models = [found for field in fields for found in _models_in(field.annotation)]
    return models


def _hint(location: tuple[int | str, ...], model: type[BaseModel] | None) -> str:
    """The known key that an unknown one is nearest to, as a question; "" if none is near."""
    models = _models_at(location[:-1], model)
    known = [field.alias or name for one in models for name, field in one.model_fields.items()]
    hint = did_you_mean(str(location[-1]), known)
    return hint and f": {hint}"


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def dotted(location: tuple[int | str, ...]) -> str:
    """`("shots", 3, "pitch_deg")` as `shots[3].pitch_deg`."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def shown(value: object) -> str:
    """The repr of a value, shortened."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        InputFileError: the file cannot be read, is not UTF-8, or is not TOML (with line and column).
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(str(path), [f"cannot be read: {error.strerror or error}"]) from error
    except UnicodeDecodeError as error:
        raise InputFileError(str(path), [f"is not UTF-8 text: byte {error.start}: {error.reason}"]) from error
    except tomllib.TOMLDecodeError as error:
        raise InputFileError(str(path), [f"is not valid TOML: {error}"]) from error
    except ValueError as error:
        # an impossible file name (it contains a zero byte)
        raise InputFileError(repr(str(path)), [f"cannot be read: {error}"]) from error
