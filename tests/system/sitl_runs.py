"""Dry-runs on an autopilot in software, what they start, and what they leave behind."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.truth import read_truth, untruths
from tests.system.dry_runs import flown, under_way
from tests.waiting import wait_until

WHOLE = ("--camera", "dji-x5s-15mm", "--overlap", "0.15", "--elevation", "-90", "30")
SMALL = ("--elevation", "-20", "20", "--azimuth", "-40", "40")
TWO_AXES = ("--yaw", "vehicle", "--elevation", "-60", "10", "--azimuth", "-90", "90")
LONG_S = 400.0


def mission(*arguments: str, speedup: float, output: Path) -> list[str]:
    """The arguments of a mission in 8 m/s of wind (later ones precede)."""
    pace = ("--speedup", f"{speedup:g}", "--image-width", "200")
    return ["--method", "paper", "--wind", "8", *pace, *arguments, "--output", str(output)]


def truly_flown(*arguments: str) -> dict[str, Any]:
    """The summary of a dry-run whose mission must have been complete, with no accepted photo that is untrue."""
    summary = flown(*arguments, timeout_s=LONG_S)
    assert_true(Path(summary["directory"]))
    return summary


def assert_true(directory: Path) -> None:
    """What the payload really exposed agrees with every accepted photo of a mission; there must be some."""
    manifest = json.loads((directory / "manifest.json").read_text(encoding="utf-8"))
    assert any(shot["accepted_attempt"] for shot in manifest["shots"])
    assert read_truth(directory / "images" / "truth.jsonl")
    assert untruths(directory) == []


def manifest_in(folder: Path) -> dict[str, Any]:
    """The manifest of the only mission in a storage folder."""
    (path,) = folder.glob("missions/*/manifest.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def taken_in(folder: Path) -> int:
    """How many shots of the only mission in a storage folder were accepted."""
    return sum(shot["status"] == "accepted" for shot in manifest_in(folder)["shots"])


def children_of(pid: int) -> set[int]:
    """All processes below one."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with contextlib.suppress(OSError):
                stat = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                parents[int(folder.name)] = int(stat[1])
    found: set[int] = set()
    grown = {pid}
    while grown:
        grown = {child for child, parent in parents.items() if parent in grown} - found
        found |= grown
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Started:
    """A dry-run under way, and the processes that it started.

    Attributes:
        process: the dry-run.
        binary: of the autopilot.
        children: process ids.
    """

    process: subprocess.Popen[str]
    binary: Path
    children: frozenset[int]

    def living(self) -> dict[int, str]:
        """Those that still run, with their command lines; ids may be used again, so an empty one is nobody's."""
        found = {}
        for pid in self.children:
            with contextlib.suppress(OSError):
                folder = Path(f"/proc/{pid}")
                if (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z":
                    found[pid] = (folder / "cmdline").read_text(encoding="utf-8").replace("\0", " ")
        return {pid: line for pid, line in found.items() if self.binary.name in line or "panoexec" in line}

    def autopilot(self) -> int:
        """The autopilot's process id."""
        (pid,) = [pid for pid, line in self.living().items() if line.startswith(str(self.binary))]
        return pid

    def assert_none_left(self, *, within_s: float) -> None:
        """No child lives any more."""
        with contextlib.suppress(TimeoutError):
            wait_until(lambda: not self.living(), within_s)
        assert self.living() == {}


@contextlib.contextmanager
def in_the_middle(arguments: Sequence[str], *, binary: Path, temporary: Path) -> Iterator[Started]:
    """A mission that has taken its first photo and begun the second."""
    with under_way(*arguments, "--json", said="shot 1, attempt", temporary=temporary) as process:
        started = Started(process=process, binary=binary, children=frozenset(children_of(process.pid)))
        assert any(line.startswith(str(binary)) for line in started.living().values())
        yield started
