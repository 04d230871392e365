"""Validation errors of pydantic as lines of text: the key, the value, and what is accepted."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from panoexec.errors import InputFileError

_LONGEST_VALUE = 60


def problem_lines(error: ValidationError) -> list[str]:
    """One line for each problem: `key: value is wrong because …`."""
    return [_line(dict(problem)) for problem in error.errors(include_url=False)]


def _line(problem: dict[str, Any]) -> str:
    key = dotted(problem["loc"]) or "the document"
    kind = problem["type"]
    if kind == "missing":
        return f"{key} is missing"
    if kind == "extra_forbidden":
        return f"{key} is not a known key"
    if kind == "value_error":
        # raised by validators of panoexec, whose text is complete
        text = str(problem["ctx"]["error"])
        return f"{key}: {text}" if problem["loc"] else text
    message = str(problem["msg"])
    return f"{key} is {shown(problem['input'])}: {message[:1].lower()}{message[1:]}"


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
