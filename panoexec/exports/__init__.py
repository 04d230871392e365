"""Exports of a plan or a mission to other programs: stitchers, spreadsheets, ground stations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from panoexec.errors import UsageError
from panoexec.exports.from_manifest import export_set
from panoexec.exports.hugin import hugin_text
from panoexec.exports.model import PLACEHOLDER, ExportSet, ExportShot, from_plan, local_name
from panoexec.exports.odm import geo_text
from panoexec.exports.papywizard import papywizard_text
from panoexec.exports.qgc_plan import qgc_text
from panoexec.exports.shots_csv import csv_text
from panoexec.exports.xmp_files import gpano_text, write_sidecars
from panoexec.files import write_atomically
from panoexec.planning.model import Plan

__all__ = [
    "FORMATS",
    "PLACEHOLDER",
    "ExportSet",
    "ExportShot",
    "check_format",
    "export_plan",
    "export_set",
    "from_plan",
    "local_name",
    "write_exports",
]

FORMATS: Final[Mapping[str, Callable[[ExportSet], str]]] = {
    "pto": hugin_text,
    "papywizard": papywizard_text,
    "csv": csv_text,
    "qgc": qgc_text,
}
"""The formats of `plan --export FORMAT=FILE`."""


def check_format(format_name: str) -> None:
    """Check the name of an export format.

    Raises:
        UsageError: it is not one of `FORMATS`.
    """
    if format_name not in FORMATS:
        raise UsageError(f"--export {format_name}: unknown format; accepted are {', '.join(FORMATS)}")


def export_plan(format_name: str, plan: Plan, path: Path) -> None:
    """Write a plan for another program, with planned attitudes and placeholder file names.

    Args:
        format_name: one of `FORMATS`.
        plan: the plan.
        path: the file to write.

    Raises:
        UsageError: an unknown format, a plan without shots, or the file cannot be written.
    """
    check_format(format_name)
    write_atomically(path, FORMATS[format_name](from_plan(plan)))


def write_exports(exports: ExportSet, folder: Path) -> list[Path]:
    """Write a mission's exports into its directory.

    `panorama.pto`, `papywizard.xml`, `shots.csv`, `panorama.xmp` (GPano values for the stitched file), `geo.txt` (where
    positions are known), `refined.pto` (where the content of photos was examined) and one sidecar per image. Without
    images only the table is written.

    Args:
        exports: accepted photos with their measured attitudes, in the order taken.
        folder: the mission directory.

    Returns:
        The files written.

    Raises:
        UsageError: a file cannot be written.
    """
    texts = {"shots.csv": csv_text(exports)}
    if exports.shots:
        texts["panorama.pto"] = hugin_text(exports)
        texts["papywizard.xml"] = papywizard_text(exports)
        texts["panorama.xmp"] = gpano_text(exports)
        refined = exports.refined()
        if refined is not None:
            texts["refined.pto"] = hugin_text(refined)
        if geo := geo_text(exports):
            texts["geo.txt"] = geo
    for name, text in texts.items():
        write_atomically(folder / name, text)
    return [folder / name for name in texts] + write_sidecars(exports, folder)
