"""The report of a mission: one self-contained HTML page (`report.html`) that needs no network."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from panoexec.errors import InputFileError
from panoexec.files import write_atomically
from panoexec.report.data import page_data
from panoexec.report.page import render_page
from panoexec.report.panorama import best_picture
from panoexec.report.source import PhotoFile, absence, read_source
from panoexec.store.directory import MissionDirectory

__all__ = ["QUICK_LOOK_CPU_S", "Report", "write_report"]

QUICK_LOOK_CPU_S: Final = 1.5
"""CPU time limit of the quick look at the end of a mission; reports made by command have no limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A report that was written.

    Attributes:
        path: the page.
        photos: accepted photos.
        problems: photos that are missing or damaged, with the shot's index.
        absent: what to do about the missing ones; "" if there are none.
        panorama: `stitched`, `quick` or "" for none.
        why_none: why there is no panorama.
        notes: files that could not be read.
    """

    path: Path
    photos: int
    problems: tuple[tuple[int, PhotoFile], ...]
    absent: str
    panorama: str
    why_none: str
    notes: tuple[str, ...]


def write_report(directory: MissionDirectory, *, max_cpu_s: float = math.inf) -> Report:
    """Write `report.html` into a mission's directory; blocks.

    Args:
        directory: with a manifest; the mission may be running, interrupted or finished.
        max_cpu_s: CPU time limit of the quick look; if it takes longer, the page has no panorama.

    Raises:
        InputFileError: the manifest is missing or damaged.
        UsageError: the page cannot be written.
    """
    try:
        source = read_source(directory)
        data = page_data(source, made_utc_s=time.time())
        picture, why_none = best_picture(source, max_cpu_s=max_cpu_s)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        where = f"{type(error).__name__}: {error}"
        raise InputFileError(str(directory.manifest), [f"is damaged or incomplete ({where})"]) from error
    data["panorama"] = (
        {"kind": "", "why": why_none} if picture is None else {"kind": picture.kind, "left_out": list(picture.left_out)}
    )
    write_atomically(directory.report, render_page(data, picture))
    return Report(
        path=directory.report,
        photos=len(source.photos),
        problems=tuple(source.photo_problems),
        absent=absence(source.photo_problems, photos=len(source.photos), folder=source.folder),
        panorama=picture.kind if picture else "",
        why_none="" if picture else why_none,
        notes=source.notes,
    )
