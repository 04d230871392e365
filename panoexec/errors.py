"""The tree of errors that panoexec raises on purpose.

Each carries the exit code that the command line ends with when nobody handled it (docs/contract.md: 1 the result falls
short; 2 wrong usage, config or input file; 3 device or link failure). Messages are one line, for a pilot: what was
found, where, and what would be accepted.
"""

from __future__ import annotations

from typing import ClassVar

_PACKAGED = "/usr/lib/panoexec/"
"""Where `packaging/stage` puts panoexec; nothing can be installed there by pip."""


class PanoexecError(Exception):
    """Root of all errors raised on purpose; its text is fit to be shown to a user as it is."""

    exit_code: ClassVar[int] = 1


class UsageError(PanoexecError):
    """A wrong argument, or an output that cannot be written."""

    exit_code = 2


class InputFileError(UsageError):
    """A file (camera profile, plan, config, scene) that cannot be read or is wrong.

    Attributes:
        source: the file, as the user named it.
        problems: every problem found, each one line that names the key, the value and what would be accepted.
    """

    def __init__(self, source: str, problems: list[str]) -> None:
        self.source = source
        self.problems = problems
        super().__init__(f"{source}: " + "; ".join(problems))


class PlanningError(UsageError):
    """A request that no plan can satisfy; the message names the constraint and by how much it fails."""


class DependencyError(UsageError):
    """An optional part of panoexec is not installed; the message says how to install it."""


def to_install(extra: str) -> str:
    """How to get an optional part of panoexec: what to type, or where it is to be had.

    Args:
        extra: one of the extras in pyproject.toml.
    """
    if __file__.startswith(_PACKAGED):
        return "the Debian package leaves it out, being for vehicles; take a clone, where `make dry-run` installs it"
    return f"pip install 'panoexec[{extra}]'"


class DeviceError(PanoexecError):
    """The gimbal, the camera or the autopilot refused, failed or did not answer in time."""

    exit_code = 3


class LinkError(DeviceError):
    """A connection (MAVLink, MQTT, serial) could not be made or was lost."""


class MissionError(PanoexecError):
    """A mission cannot go on or cannot be resumed."""
