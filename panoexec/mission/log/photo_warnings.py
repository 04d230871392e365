"""Warnings about the files of photos: one for each kind, kept up to date while photos arrive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_SHOWN: Final = 4
"""Photos that a warning names."""


class PhotoWarnings:
    """Keeps its warnings in the mission's list of warnings."""

    def __init__(self, warnings: list[str]) -> None:
        """Create it.

        Args:
            warnings: of the mission; changed here.
        """
        self._warnings = warnings
        self._others: dict[int, str] = {}
        self._told: dict[str, str] = {}

    def settings(self, shot: int, differs: str) -> None:
        """A photo was taken with other settings than the mission's first."""
        self._others[shot] = differs
        self._tell("settings", "photos were taken with other settings than the first", self._others)

    def times(self, found: Mapping[int, str]) -> None:
        """All photos whose own time contradicts their attempt, by shot, with the reason."""
        self._tell("times", "photos contradict the time of their trigger", found)

    def _tell(self, kind: str, what: str, found: Mapping[int, str]) -> None:
        before = self._told.pop(kind, "")
        if before in self._warnings:
            self._warnings.remove(before)
        if not found:
            return
        shown = [f"shot {shot} ({text})" for shot, text in list(found.items())[:_SHOWN]]
        more = f"; and {len(found) - len(shown)} more" if len(found) > len(shown) else ""
        self._told[kind] = f"{len(found)} {what}: {'; '.join(shown)}{more}"
        self._warnings.append(self._told[kind])
