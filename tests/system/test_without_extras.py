"""panoexec installed without its extras: what does not need them works, what does says which to install.

A process in which Python does not find a package, as in an environment that it was not installed in.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from panoexec.errors import to_install
from tests.report_missions import photographed

SIM = ("pymavlink",)
VEHICLE = ("mavsdk", "serial", "pymavlink", "gphoto2")
WITHOUT = """
import sys
from importlib.machinery import PathFinder

class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in MISSING:
            return None
        return PathFinder.find_spec(name, path, target)

sys.meta_path = [Finder if finder is PathFinder else finder for finder in sys.meta_path]
for name in MISSING:
    try:
        __import__(name)
    except ModuleNotFoundError:
        pass
    else:
        raise SystemExit(f"{name} is found all the same")
"""
PLAN = ("--camera", "dji-x5s-15mm", "--elevation", "-20", "20", "--azimuth", "-60", "60")
RUN = "from panoexec.cli.app import run; raise SystemExit(run(sys.argv[1:]))"


def command(program: str, *arguments: str, missing: tuple[str, ...]) -> list[str]:
    """The command line of a process that does not find some packages."""
    return [sys.executable, "-c", f"MISSING = {missing}\n{WITHOUT}{program}", *arguments]


def python(program: str, *arguments: str, missing: tuple[str, ...] = SIM) -> subprocess.CompletedProcess[str]:
    line = command(program, *arguments, missing=missing)
    return subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("verb", ["dry-run", "simulate"])
def test_what_needs_the_extra_says_how_to_install_it(tmp_path: Path, verb: str) -> None:
    done = python(RUN, verb, "--output", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "pip install '.[sim]'" in done.stderr
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


def test_a_ground_computer_does_without_mavsdk(tmp_path: Path) -> None:
    """What 32-bit ARM and older macOS can install: all but what talks to a vehicle, which says what it needs."""
    program = """
# the modules that Windows has not
sys.modules |= dict.fromkeys(("grp", "pwd", "resource", "termios"))
from panoexec.cli.app import COMMANDS, module_of, parser_of
from panoexec.errors import DependencyError
for name in COMMANDS:
    try:
        parser_of(name, module_of(name))
    except DependencyError as error:
        print(name, error)
"""
    done = python(program, missing=VEHICLE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"dry-run `dry-run` needs the Python package mavsdk: {to_install('sim')}",
        f"serve `serve` needs the Python package mavsdk: {to_install('vehicle')}",
        f"doctor `doctor` needs the Python package mavsdk: {to_install('vehicle')}",
    ]
    done = python(RUN, "demo", "--output", str(tmp_path / "out"), missing=VEHICLE)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "pip install '.[sim]'" in done.stderr
    directory = photographed(tmp_path / "20260921T141300.000Z", width_px=32)
    done = python(RUN, "report", str(directory.path), missing=VEHICLE)
    assert done.returncode == 0, done.stderr
