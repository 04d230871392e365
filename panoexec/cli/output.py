"""What verbs print: tables for people and one JSON document for programs on stdout; everything else on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

_FILE_WIDTH = 160


def console(*, stderr: bool = False) -> Console:
    """A rich console, imported only when something is shown to a person."""
    from rich.console import Console  # noqa: PLC0415

    is_terminal = (sys.stderr if stderr else sys.stdout).isatty()
    # a file or a pipe has no width: tables there are as wide as they like
    return Console(stderr=stderr, highlight=False, width=None if is_terminal else _FILE_WIDTH)


def has_colours(out: Console) -> bool:
    """Whether colours tell anything there: a terminal that knows some, and a person who has not set NO_COLOR."""
    return out.color_system is not None and not out.no_color


def print_json(document: object) -> None:
    """Exactly one JSON document on stdout."""
    print(json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False))


def note(text: str) -> None:
    """A line for a person, on stderr."""
    print(text, file=sys.stderr)


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: Iterable[str] = (), caption: str = ""
) -> None:
    """A table on stdout.

    Args:
        title: above it.
        columns: headings; columns are right-aligned unless named in `left`.
        rows: cells.
        left: headings of left-aligned columns.
        caption: below it.
    """
    from rich import box  # noqa: PLC0415
    from rich.table import Table  # noqa: PLC0415
    from rich.text import Text  # noqa: PLC0415

    table = Table(
        title=title or None, caption=caption or None, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold"
    )
    table.caption_justify = "left"
    left_columns = set(left)
    for column in columns:
        table.add_column(column, justify="left" if column in left_columns else "right", no_wrap=column in left_columns)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console().print(table)


def print_facts(facts: Iterable[tuple[str, str]]) -> None:
    """Aligned lines `name   value` on stdout."""
    listed = list(facts)
    width = max((len(name) for name, _ in listed), default=0) + 2
    for name, value in listed:
        print(f"{name:<{width}}{value}")


def percent(fraction: float | None, digits: int = 1) -> str:
    """A fraction as a percentage, `-` for none."""
    return "-" if fraction is None else f"{100 * fraction:.{digits}f} %"


def completeness(fraction: float) -> str:
    """A completeness (equation 8) as a percentage, never 100 % by rounding."""
    digits = 2
    while fraction < 1 and round(100 * fraction, digits) >= 100 and digits < 9:
        digits += 1
    return percent(fraction, digits)


def minutes(seconds: float) -> str:
    """A duration as `m:ss`, or `h:mm:ss`."""
    total = round(seconds)
    hours, rest = divmod(total, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"
