"""Dry-runs as processes, and what they leave behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

DRY_RUN = (sys.executable, "-m", "panoexec", "dry-run")


def dry_run(*arguments: str, timeout_s: float = 180) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*DRY_RUN, *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)


def flown(*arguments: str, timeout_s: float = 180) -> dict[str, Any]:
    """The summary of a dry-run whose mission must have been complete."""
    done = dry_run(*arguments, "--json", timeout_s=timeout_s)
    assert done.returncode == 0, done.stderr
    summary: dict[str, Any] = json.loads(done.stdout)
    assert (summary["state"], summary["missing"]) == ("complete", []), summary
    return summary


def manifest_of(summary: dict[str, Any]) -> dict[str, Any]:
    text = (Path(summary["directory"]) / "manifest.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def accepted(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The accepted attempt of each shot, with the shot's target; every shot must have one."""
    return [
        next(a for a in shot["attempts"] if a["number"] == shot["accepted_attempt"]) | {"target": shot["target"]}
        for shot in manifest["shots"]
    ]
