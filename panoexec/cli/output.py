"""Output of the commands: tables or one JSON document on stdout, everything else on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from panoexec.cli.streams import can_encode_all

if TYPE_CHECKING:
    from rich.console import Console

_FILE_WIDTH = 160


def console(*, stderr: bool = False) -> Console:
    """A rich console; rich is imported only when a console is needed."""
    from rich.console import Console  # noqa: PLC0415

    is_terminal = (sys.stderr if stderr else sys.stdout).isatty()
    # a file or a pipe has no width: use a fixed large one
    return Console(stderr=stderr, highlight=False, width=None if is_terminal else _FILE_WIDTH)


def has_colours(out: Console) -> bool:
    """Whether to draw in colour: the terminal supports colours and NO_COLOR is not set."""
    return out.color_system is not None and not out.no_color


def print_json(document: object) -> None:
    """Print exactly one JSON document on stdout."""
    print(json.dumps(document, indent=1, ensure_ascii=not can_encode_all(sys.stdout), allow_nan=False))


def note(text: str) -> None:
    """Print one line of text on stderr."""
    print(text, file=sys.stderr)


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: Iterable[str] = (), caption: str = ""
) -> None:
    """Print a table on stdout.

    Args:
        title: text above the table.
        columns: headings; columns are right-aligned unless named in `left`.
        rows: cell texts.
        left: headings of left-aligned columns.
        caption: text below the table.
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
    """Print aligned lines `name   value` on stdout."""
    listed = list(facts)
    width = max((len(name) for name, _ in listed), default=0) + 2
    for name, value in listed:
        print(f"{name:<{width}}{value}")


def percent(fraction: float | None, digits: int = 1) -> str:
    """A fraction as a percentage, `-` for None."""
    return "-" if fraction is None else f"{100 * fraction:.{digits}f} %"


def completeness(fraction: float) -> str:
    """A completeness (equation 8) as a percentage; a fraction below 1 is never rounded to 100 %."""
    digits = 2
    while fraction < 1 and round(100 * fraction, digits) >= 100 and digits < 9:
        digits += 1
    return percent(fraction, digits)


def in_words(seconds: float) -> str:
    """A duration as `36 s`, `4 min 30 s` or `1 h 5 min`."""
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    if total < 3600:
        return f"{total // 60} min {total % 60} s"
    total = round(seconds / 60)
    return f"{total // 60} h {total % 60} min"


def minutes(seconds: float) -> str:
    """A duration as `m:ss`, or `h:mm:ss`."""
    total = round(seconds)
    hours, rest = divmod(total, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


def counted(number: int, noun: str) -> str:
    """A number with its noun: `1 image`, `2 images`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def local_time(mission_id: str, style: str = "%H:%M") -> str:
    """When a mission began by the clock of this computer's time zone; "" where that is UTC, as the id has it.

    Args:
        mission_id: its UTC time (docs/contract.md); anything else gives "".
        style: as `strftime` has it.
    """
    try:
        began = datetime.fromisoformat(mission_id.partition(".")[0]).replace(tzinfo=UTC).astimezone()
    except (ValueError, OverflowError):
        return ""
    return began.strftime(style) if began.utcoffset() else ""
