"""The exceptions that panoexec raises deliberately.

Each carries the exit code that the command line ends with when nobody handled it (docs/contract.md: 1 the result falls
short; 2 wrong usage, config or input file; 3 device or link failure). Messages are one line, for a pilot: what was
found, where, and what would be accepted.
"""

from __future__ import annotations

from typing import ClassVar

_PACKAGED = "/usr/lib/panoexec/"
"""Install path of the Debian package; pip cannot install anything there."""


class PanoexecError(Exception):
    """Base class of all deliberate errors; its text can be shown to users unchanged."""

    exit_code: ClassVar[int] = 1


class UsageError(PanoexecError):
    """An invalid argument, or an output that cannot be written."""

    exit_code = 2


class InputFileError(UsageError):
    """A file (camera profile, plan, config, scene) that cannot be read or is invalid.

    Attributes:
        source: the file, as given by the user.
        problems: all problems, each one line with the key, the value and what is accepted.
    """

    def __init__(self, source: str, problems: list[str]) -> None:
        self.source = source
        self.problems = problems
        super().__init__(f"{source}: " + "; ".join(problems))


class PlanningError(UsageError):
    """Constraints that no plan can satisfy; the message names the constraint and by how much it is missed."""


class DependencyError(UsageError):
    """An optional part of panoexec is not installed; the message says how to install it."""


def to_install(extra: str) -> str:
    """How to install an optional part of panoexec.

    Args:
        extra: one of the extras in pyproject.toml.
    """
    if __file__.startswith(_PACKAGED):
        return "not part of the Debian package, which is for vehicles; use a clone, where `make dry-run` installs it"
    return f"pip install '.[{extra}]' in a clone, with the pip of its virtual environment"


class DeviceError(PanoexecError):
    """The gimbal, the camera or the autopilot refused, failed or did not answer in time.

    Args:
        text: what happened.
        advice: what to set or do; "" if the text says it, or what helps is not known.
    """

    exit_code = 3

    def __init__(self, text: str = "", *, advice: str = "") -> None:
        self.advice = advice
        super().__init__(text)


class LinkError(DeviceError):
    """A connection (MAVLink, MQTT, serial) could not be made or was lost."""


class PhotoFileError(DeviceError):
    """The file of a photo could not be brought here.

    Attributes:
        final: trying again would not help: it is not allowed, or no photo.
    """

    def __init__(self, message: str, *, final: bool = False) -> None:
        self.final = final
        super().__init__(message)


class MissionError(PanoexecError):
    """A mission cannot continue or cannot be resumed."""
