"""What `make` installs: progress meanwhile, what apt and pip say when they fail, and no service that nobody wants."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Final

import pytest

from tests.repository import ROOT

APT: Final = """#!/bin/sh
case "$*" in
*update*) echo 'Hit:1 http://deb.debian.org/debian bookworm InRelease' ;;
*)
    echo 'Reading package lists...'
    echo '0 upgraded, 40 newly installed, 0 to remove and 0 not upgraded.'
    echo 'Need to get 3,213 kB/6,766 kB of archives.'
    for word in Get: Unpacking Setting; do
        for n in $(seq 40); do
            case $word in
            Get:) echo "Get:$n http://deb.debian.org/debian bookworm/main amd64 p$n amd64 1 [2 kB]" ;;
            Unpacking) echo "Unpacking p$n (1) ..." ;;
            *) echo "Setting up p$n (1) ..." ;;
            esac
        done
    done
    echo 'debconf: delaying package configuration, since apt-utils is not installed' >&2
    ;;
esac
"""
BROKEN_APT: Final = """#!/bin/sh
case "$*" in *update*) exit 0 ;; esac
echo 'Reading package lists...'
echo 'E: Unable to locate package mosquitto' >&2
exit 100
"""
RECORDED: Final = '#!/bin/sh\necho "$(basename "$0") $*" >>"$RECORD"\n'
PIP: Final = """#!/bin/sh
echo 'Collecting numpy>=2 (from panoexec)'
read -r go <"$FIFO"
echo '  Collecting rich'
echo 'Installing collected packages: numpy, rich'
"""
BROKEN_PIP: Final = """#!/bin/sh
echo 'Collecting numpy'
echo 'ERROR: No matching distribution found for numpy'
echo 'more of it'
exit 7
"""


def programs(folder: Path, **texts: str) -> dict[str, str]:
    """The environment in which these programs are found, before all others."""
    folder.mkdir()
    for name, text in texts.items():
        file = folder / name.replace("_", "-")
        file.write_text(text)
        file.chmod(0o755)
    return os.environ | {"PATH": f"{folder}:/usr/bin:/bin", "RECORD": str(folder / "record")}


def test_apt_is_heard_only_by_its_progress(tmp_path: Path) -> None:
    env = programs(tmp_path / "bin", apt_get=APT)
    done = subprocess.run([ROOT / ".ci/apt", "hugin-tools"], env=env, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "")
    dots = "." * 20
    assert done.stderr == (
        f"installing hugin-tools from Debian: package lists … 40 packages, 6,766 kB {dots} "
        f"unpacking {dots} setting up {dots} done\n"
    )


def test_what_apt_says_is_shown_when_it_fails(tmp_path: Path) -> None:
    env = programs(tmp_path / "bin", apt_get=BROKEN_APT)
    done = subprocess.run([ROOT / ".ci/apt", "mosquitto"], env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 100
    assert "\nE: Unable to locate package mosquitto\n" in done.stderr
    assert "done" not in done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="only root installs")
def test_a_broker_that_is_installed_becomes_no_service(tmp_path: Path) -> None:
    names = ("systemctl", "invoke_rc.d", "deb_systemd_helper", "update_rc.d")
    env = programs(tmp_path / "bin", apt_get=APT, **dict.fromkeys(names, RECORDED))
    for tool in ("sh", "id", "dirname", "basename", "mktemp", "rm", "tee", "cat", "seq"):
        (tmp_path / "bin" / tool).symlink_to(f"/usr/bin/{tool}")
    # `mosquitto` of this computer is not to be found: the script looks in /usr/sbin, too
    script = (ROOT / ".ci/setup").read_text().replace("PATH=$PATH:/usr/sbin", "")
    (tmp_path / "apt").symlink_to(ROOT / ".ci/apt")
    (tmp_path / "setup").write_text(script)
    env["PATH"] = str(tmp_path / "bin")
    done = subprocess.run(
        ["/bin/sh", tmp_path / "setup", "broker"], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    record = (tmp_path / "bin" / "record").read_text().splitlines()
    assert "update-rc.d mosquitto disable" in record
    assert {"systemctl --quiet disable --now mosquitto", "invoke-rc.d --quiet mosquitto stop"} & {*record}
    assert "mosquitto is installed but is no service here" in done.stderr


def test_each_package_of_pip_is_named_when_it_is_collected(tmp_path: Path) -> None:
    """Not when 4 kB have come together, as with Debian's awk: here pip waits until its first package is told."""
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    env = programs(tmp_path / "bin", python=PIP) | {"FIFO": str(fifo)}
    argv = [str(ROOT / ".ci/pip"), str(tmp_path / "bin" / "python"), "installing (once)", "."]
    with subprocess.Popen(argv, env=env, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        told = b""
        while b" numpy" not in told:
            told += os.read(process.stderr.fileno(), 100)
        fifo.write_text("go\n")
        told += process.stderr.read()
    assert process.returncode == 0
    assert told.decode() == "installing (once): numpy rich … unpacking … done\n"


def test_what_pip_says_is_shown_from_its_error_on(tmp_path: Path) -> None:
    env = programs(tmp_path / "bin", python=BROKEN_PIP)
    argv = [str(ROOT / ".ci/pip"), str(tmp_path / "bin" / "python"), "installing (once)", "."]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 7
    assert done.stderr == ("installing (once): numpy\nERROR: No matching distribution found for numpy\nmore of it\n\n")
