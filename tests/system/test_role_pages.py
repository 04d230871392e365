"""The planning commands of the researcher's page do what the page says, in the order in which they stand there.

Other commands of these pages need minutes, a vehicle or a package; test_docs.py holds their options to the program.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from tests.repository import ROOT

PAGE = (ROOT / "docs" / "researcher.md").read_text(encoding="utf-8")


def block(heading: str) -> str:
    """The commands below a heading."""
    found = re.search(rf"^## {re.escape(heading)}\n.*?```sh\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL)
    assert found
    return found[1]


def typed(commands: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """In a shell whose `panoexec` is this one."""
    program = folder / "bin" / "panoexec"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m panoexec "$@"\n')
    program.chmod(0o755)
    env = os.environ | {"PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    command = ["bash", "-euo", "pipefail", "-c", commands]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False)


def test_what_a_researcher_types_works(tmp_path: Path) -> None:
    done = typed(block("Plans and their proof"), tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "not covered with this tolerance" in done.stdout
    assert "a published plan with holes" in done.stdout
    plan = json.loads((tmp_path / "plan.json").read_text())
    assert plan["certificate"]["certified"]
    assert done.stdout.endswith("not certified\n")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
