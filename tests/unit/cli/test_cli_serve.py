"""What the daemon does not carry with it."""

from __future__ import annotations

import subprocess
import sys


def test_the_daemon_imports_nothing_that_it_never_needs() -> None:
    heavy = {"rich", "matplotlib", "PIL", "pymavlink", "panoexec.sim", "panoexec.sitl", "panoexec.stitching"}
    program = f"import sys, panoexec.cli.serve; print(*sorted(set(sys.modules) & {heavy}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_rich_is_there_for_those_who_draw() -> None:
    program = "import panoexec.cli.lean, structlog, rich.table"
    subprocess.run([sys.executable, "-c", program], check=True)
