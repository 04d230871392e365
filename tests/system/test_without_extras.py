"""panoexec installed without its extra `sim`: the daemon lacks nothing, a dry-run says what to install.

A process in which Python finds neither pymavlink nor Pillow, as in an environment that they were not installed in.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.report_missions import photographed

WITHOUT = """
import sys
from importlib.machinery import PathFinder

class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {"pymavlink", "PIL"}:
            return None
        return PathFinder.find_spec(name, path, target)

sys.meta_path = [Finder if finder is PathFinder else finder for finder in sys.meta_path]
try:
    import pymavlink
except ModuleNotFoundError:
    pass
else:
    raise SystemExit("it is found all the same")
"""
PLAN = ("--camera", "dji-x5s-15mm", "--elevation", "-10", "10", "--azimuth", "-30", "30")
RUN = "from panoexec.cli.app import run; raise SystemExit(run(sys.argv[1:]))"


def python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT + program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("verb", ["dry-run", "simulate"])
def test_what_needs_the_extra_says_how_to_install_it(tmp_path: Path, verb: str) -> None:
    done = python(RUN, verb, "--output", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "pip install 'panoexec[sim]'" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_everything_else_starts(tmp_path: Path) -> None:
    assert python(RUN, "--help").returncode == 0
    for verb in ("dry-run", "serve"):
        assert python(RUN, verb, "--help").returncode == 0, verb
    plan = tmp_path / "plan.json"
    done = python(RUN, "plan", *PLAN, "--output", str(plan))
    assert done.returncode == 0, done.stderr
    assert python(RUN, "verify", str(plan)).returncode == 0


def test_the_daemon_has_all_that_it_needs() -> None:
    program = """
import pkgutil
import panoexec.adapters, panoexec.mission, panoexec.mqtt, panoexec.daemon
for package in (panoexec.adapters, panoexec.mission, panoexec.mqtt, panoexec.daemon):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        __import__(module.name)
import panoexec.cli.serve, panoexec.cli.doctor
print(*sorted(name for name in sys.modules if name.startswith(("panoexec.sim", "panoexec.dryrun"))))
"""
    done = python(program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""


def test_the_report_goes_without_a_picture_and_the_experiment_says_what_it_needs(tmp_path: Path) -> None:
    directory = photographed(tmp_path / "20260921T141300.000Z", width_px=32)
    done = python(RUN, "report", str(directory.path))
    assert done.returncode == 0, done.stderr
    assert "no panorama: needs Pillow: pip install 'panoexec[report]'" in done.stderr
    assert 'id="panorama-jpeg"' not in directory.report.read_text(encoding="utf-8")
    done = python(RUN, "experiment", "--scenario", "1", "--output", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "pip install 'panoexec[sim]'" in done.stderr
    assert not (tmp_path / "out").exists()
