"""Findings of the checks, and the result that they add up to."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Final, Self


class Verdict(StrEnum):
    """Severity of a finding for a mission."""

    OK = "ok"
    NOTE = "note"
    """For information; a mission is possible."""
    WARNING = "warning"
    """A mission is possible, but with reduced quality or safety."""
    MISSING = "missing"
    """A mission is not possible, or cannot be commanded."""


DEVICE_AREAS: Final = frozenset({"link", "rates", "gimbal", "camera", "vehicle", "broker"})
"""Areas in which a missing item is a failure of a device or a link."""

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
"""Areas in display order."""

EXIT_FALLS_SHORT: Final = 1
EXIT_DEVICE: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check.

    Attributes:
        area: one of `AREAS`.
        check: name of the check.
        verdict: severity.
        found: the observed state, for display.
        needed: what a mission needs; "" if obvious.
        advice: parameter or configuration key to set; "" if nothing needs to be done.
    """

    area: str
    check: str
    verdict: Verdict
    found: str
    needed: str = ""
    advice: str = ""


class Findings:
    """The findings so far.

    Attributes:
        autopilot: ardupilot or px4; "" until it is detected.
        examined_by: `doctor`, on a link of its own, or `daemon`, on the daemon's link.
    """

    def __init__(self) -> None:
        self.autopilot = ""
        self.examined_by = "doctor"
        self._found: list[Finding] = []

    @property
    def all(self) -> list[Finding]:
        """All findings in display order, grouped by area."""
        return sorted(self._found, key=lambda finding: AREAS.index(finding.area))

    def ok(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Add a check that passed."""
        self._add(area, check, Verdict.OK, found, needed=needed, advice=advice)

    def note(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Add information."""
        self._add(area, check, Verdict.NOTE, found, needed=needed, advice=advice)

    def warning(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Add a warning."""
        self._add(area, check, Verdict.WARNING, found, needed=needed, advice=advice)

    def missing(self, area: str, check: str, found: str, *, needed: str = "", advice: str = "") -> None:
        """Add a problem that prevents a mission."""
        self._add(area, check, Verdict.MISSING, found, needed=needed, advice=advice)

    def judge(self, area: str, check: str, good: object, found: str, *, needed: str = "", advice: str = "") -> None:
        """Add a passed check if `good`, else a problem with advice."""
        verdict = Verdict.OK if good else Verdict.MISSING
        self._add(area, check, verdict, found, needed=needed, advice="" if good else advice)

    def _add(self, area: str, check: str, verdict: Verdict, found: str, *, needed: str, advice: str) -> None:
        self._found.append(Finding(area=area, check=check, verdict=verdict, found=found, needed=needed, advice=advice))

    def count(self, verdict: Verdict) -> int:
        """Number of findings with this verdict."""
        return Counter(finding.verdict for finding in self._found)[verdict]

    @property
    def exit_code(self) -> int:
        """3 if a device or a link is missing, 1 if something else is, 0 otherwise."""
        areas = {finding.area for finding in self._found if finding.verdict is Verdict.MISSING}
        if areas & DEVICE_AREAS:
            return EXIT_DEVICE
        return EXIT_FALLS_SHORT if areas else 0

    def document(self) -> dict[str, Any]:
        """The findings as a JSON object (`panoexec.doctor/1`)."""
        return {
            "format": "panoexec.doctor/1",
            "healthy": self.exit_code == 0,
            "autopilot": self.autopilot or None,
            "examined_by": self.examined_by,
            "counts": {verdict.value: self.count(verdict) for verdict in Verdict},
            "findings": [asdict(finding) | {"verdict": finding.verdict.value} for finding in self.all],
        }

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Self:
        """The findings that `document` described.

        Raises:
            ValueError: an unknown area or verdict.
        """
        findings = cls()
        findings.autopilot = document["autopilot"] or ""
        findings.examined_by = document["examined_by"]
        for fields in document["findings"]:
            if fields["area"] not in AREAS:
                raise ValueError(f"unknown area {fields['area']!r}")
            findings._found.append(Finding(**(fields | {"verdict": Verdict(fields["verdict"])})))
        return findings
