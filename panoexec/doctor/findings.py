"""Findings of an examination, and what they add up to."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Final


class Verdict(StrEnum):
    """What a finding means for a mission."""

    OK = "ok"
    NOTE = "note"
    """Worth knowing; nothing speaks against a mission."""
    WARNING = "warning"
    """A mission can be flown, but less well or less safely."""
    MISSING = "missing"
    """No mission can be flown so, or nobody could command it."""


DEVICE_AREAS: Final = frozenset({"link", "rates", "gimbal", "camera", "vehicle", "broker"})
"""Areas in which something missing is a failure of a device or a link."""

AREAS: Final = (
    "link",
    "rates",
    "gimbal",
    "camera",
    "vehicle",
    "mission",
    "broker",
    "clock",
    "disk",
    "permissions",
)
"""In the order in which they are shown."""

EXIT_FALLS_SHORT: Final = 1
EXIT_DEVICE: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        area: one of `AREAS`.
        check: what was looked at.
        verdict: what it means.
        found: what there is, for people.
        needed: what a mission needs, "" if that goes without saying.
        advice: what to do about it: the parameter or the key to set; "" if nothing is to be done.
    """

    area: str
    check: str
    verdict: Verdict
    found: str
    needed: str = ""
    advice: str = ""


class Findings:
    """What was found so far.

    Attributes:
        autopilot: ardupilot or px4; "" before it was found.
    """

    def __init__(self) -> None:
        self.autopilot = ""
        self._found: list[Finding] = []

    @property
    def all(self) -> list[Finding]:
        """Everything, area by area in the order in which it is shown."""
        return sorted(self._found, key=lambda finding: AREAS.index(finding.area))

    def ok(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """All is well."""
        self._add(area, check, Verdict.OK, found, needed=needed, advice=advice)

    def note(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Worth knowing."""
        self._add(area, check, Verdict.NOTE, found, needed=needed, advice=advice)

    def warning(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Less well."""
        self._add(area, check, Verdict.WARNING, found, needed=needed, advice=advice)

    def missing(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """No mission."""
        self._add(area, check, Verdict.MISSING, found, needed=needed, advice=advice)

    def judge(self, area: str, check: str, good: object, found: str, *, needed: str = "", advice: str = "") -> None:
        """Well, or missing with advice."""
        verdict = Verdict.OK if good else Verdict.MISSING
        self._add(area, check, verdict, found, needed=needed, advice="" if good else advice)

    def _add(self, area: str, check: str, verdict: Verdict, found: str, *, needed: str, advice: str) -> None:
        self._found.append(Finding(area=area, check=check, verdict=verdict, found=found, needed=needed, advice=advice))

    def count(self, verdict: Verdict) -> int:
        """How many findings have this verdict."""
        return Counter(finding.verdict for finding in self._found)[verdict]

    @property
    def exit_code(self) -> int:
        """3 if a device or a link is missing, 1 if something else is, 0 otherwise."""
        areas = {finding.area for finding in self._found if finding.verdict is Verdict.MISSING}
        if areas & DEVICE_AREAS:
            return EXIT_DEVICE
        return EXIT_FALLS_SHORT if areas else 0

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "format": "panoexec.doctor/1",
            "healthy": self.exit_code == 0,
            "autopilot": self.autopilot or None,
            "counts": {verdict.value: self.count(verdict) for verdict in Verdict},
            "findings": [asdict(finding) | {"verdict": finding.verdict.value} for finding in self.all],
        }
