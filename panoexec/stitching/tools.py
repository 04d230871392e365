"""Runs Hugin's command-line tools and reports missing tools and failures."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar, Final

from panoexec.errors import PanoexecError

NEEDED: Final = ("nona",)
_INSTALL: Final = "install them with  apt-get install hugin-tools"
_LITTLE_SPACE_BYTES: Final = 64 << 20


class StitchError(PanoexecError):
    """The mission cannot be stitched: no photos, too few, or damaged ones."""


class ToolError(PanoexecError):
    """One of Hugin's tools is missing or failed, or the disk is full; completed steps are kept."""

    exit_code: ClassVar[int] = 3


def check_tools(*, cpfind: bool = False) -> None:
    """Check that Hugin's tools are installed.

    Args:
        cpfind: whether Hugin's matcher is needed, too.

    Raises:
        ToolError: some are missing; the message says how to install them.
    """
    missing = [name for name in (*NEEDED, *(("cpfind",) if cpfind else ())) if shutil.which(name) is None]
    if missing:
        raise ToolError(f"Hugin's tools are not installed (missing: {', '.join(missing)}): {_INSTALL}")


def run_tool(command: Sequence[str], folder: Path, on_line: Callable[[str], None] | None = None) -> None:
    """Run a tool in a folder and wait for its end; it is killed if this process is.

    Args:
        command: the tool and its arguments.
        folder: working directory.
        on_line: called with each line that it prints.

    Raises:
        ToolError: it could not be started or failed; the message has its last output, and whether the disk is full.
    """
    name = command[0]
    last: deque[str] = deque(maxlen=3)
    try:
        # a fixed locale, so that the output can be parsed
        process = subprocess.Popen(  # noqa: S603  (fixed names, no shell)
            list(command), cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", env=os.environ | {"LC_ALL": "C"},
        )  # fmt: skip
    except OSError as error:
        raise ToolError(f"{name} cannot be started ({error.strerror}): {_INSTALL}") from error
    with process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                if line.strip():
                    last.append(line.strip())
                if on_line is not None:
                    on_line(line.rstrip("\n"))
            code = process.wait()
        finally:
            if process.poll() is None:
                process.kill()
    if code:
        ended = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
        raise ToolError(f"{name} {ended}{_full(folder)}: {' | '.join(last) or 'no output'}")


def disk_error(folder: Path, error: OSError) -> ToolError:
    """The error for a failed write below `folder`."""
    reason = error.strerror or type(error).__name__
    return ToolError(f"{folder}: cannot be written ({reason}{_full(folder)}); completed steps are kept")


def _full(folder: Path) -> str:
    """A note if the folder's disk is almost full."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return ""
    return f" (only {free >> 20} MiB left on the disk)" if free < _LITTLE_SPACE_BYTES else ""
