"""Dry-runs as processes, and what they leave behind."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

DRY_RUN = (sys.executable, "-m", "panoexec", "dry-run")


def dry_run(*arguments: str, timeout_s: float = 300) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*DRY_RUN, *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)


def flown(*arguments: str, timeout_s: float = 300) -> dict[str, Any]:
    """The summary of a dry-run whose mission must have been complete."""
    done = dry_run(*arguments, "--json", timeout_s=timeout_s)
    assert done.returncode == 0, done.stderr
    summary: dict[str, Any] = json.loads(done.stdout)
    assert (summary["state"], summary["missing"]) == ("complete", []), summary
    return summary


@contextlib.contextmanager
def under_way(*arguments: str, said: str, temporary: Path | None = None) -> Iterator[subprocess.Popen[str]]:
    """A dry-run that leads a session of its own, once a line of its log says something.

    Args:
        arguments: after `dry-run`.
        said: what a line of the log has to contain.
        temporary: folder for temporary files; None for the usual one.

    Yields:
        The process, whose output and log from there on can be read; it is killed if the block raises.
    """
    with subprocess.Popen(
        [*DRY_RUN, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | ({} if temporary is None else {"TMPDIR": str(temporary)}),
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        log = []
        try:
            for line in process.stderr:
                log.append(line)
                if said in line:
                    break
            else:
                pytest.fail(f"the log does not say {said!r}: " + "".join(log))
            yield process
        except BaseException:
            process.kill()
            raise


def manifest_of(summary: dict[str, Any]) -> dict[str, Any]:
    text = (Path(summary["directory"]) / "manifest.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def accepted(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The accepted attempt of each shot, with the shot's target; every shot must have one."""
    return [
        next(a for a in shot["attempts"] if a["number"] == shot["accepted_attempt"]) | {"target": shot["target"]}
        for shot in manifest["shots"]
    ]
