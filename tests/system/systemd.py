"""The machine that a test runs on, booted by systemd, where it may install and purge panoexec."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path

UNIT = "panoexec.service"
CONFIG = Path("/etc/panoexec/config.toml")
STATE = Path("/var/lib/panoexec")
LEFT = (
    "/etc/panoexec",
    "/var/lib/panoexec",
    "/run/panoexec",
    "/usr/lib/panoexec",
    "/usr/bin/panoexec",
    "/usr/share/panoexec",
    "/usr/lib/sysusers.d/panoexec.conf",
    "/usr/lib/tmpfiles.d/panoexec.conf",
    "/usr/share/man/man1/panoexec.1.gz",
    "/usr/share/bash-completion/completions/panoexec",
    "/usr/share/zsh/vendor-completions/_panoexec",
    "/usr/share/fish/vendor_completions.d/panoexec.fish",
    f"/usr/lib/systemd/system/{UNIT}",
    f"/etc/systemd/system/multi-user.target.wants/{UNIT}",
    f"/etc/systemd/system/{UNIT}.d",
    f"/var/lib/systemd/deb-systemd-helper-enabled/{UNIT}.dsh-also",
)
"""What nothing of may be left after a purge."""


def why_not() -> str:
    """Why nothing may be installed here, "" if it may."""
    if os.environ.get("PANOEXEC_SYSTEMD") != "1":
        return "installs and purges panoexec on this machine: set PANOEXEC_SYSTEMD=1 if that is wanted"
    if os.geteuid() != 0 or not Path("/run/systemd/system").is_dir() or shutil.which("dpkg") is None:
        return "needs root on a Debian booted by systemd"
    if STATE.exists() or CONFIG.exists():
        return f"panoexec is on this machine already ({STATE} or {CONFIG}): nothing of it is touched"
    return ""


def sh(*command: str, check: bool = True, environment: Mapping[str, str] | None = None) -> str:
    """What a command says on its standard output."""
    env = os.environ | {"LC_ALL": "C"} | dict(environment or {})
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert not check or done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"
    return done.stdout


def show(name: str) -> str:
    """A property of the unit."""
    return sh("systemctl", "show", UNIT, "--property", name, "--value").strip()


def wait(what: str, condition: Callable[[], object], limit_s: float = 60.0) -> None:
    """Return once the condition holds."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, (
            f"{what}: not within {limit_s} s; {sh('systemctl', 'status', UNIT, check=False)}"
        )
        time.sleep(0.1)


def running() -> bool:
    """Whether the daemon has said READY and lives."""
    return show("ActiveState") == "active" and show("SubState") == "running"


def nothing_left() -> None:
    """Assert that a purge has taken everything."""
    assert [path for path in LEFT if Path(path).exists() or Path(path).is_symlink()] == []
    assert show("LoadState") == "not-found"
    assert "panoexec" not in sh(
        "find", "/etc", "/usr/lib", "/usr/bin", "/usr/share", "/var/lib/panoexec", "-name", "*panoexec*", check=False
    )
