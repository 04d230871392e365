"""`make install` on a machine that systemd runs: a daemon that runs, an upgrade, a failed one, removal, purge.

Like test_deb.py it only runs where that is wanted: as root on a Debian booted by systemd, with PANOEXEC_SYSTEMD=1. The
tests are the chapters of one story and need each other, in this order.
"""

from __future__ import annotations

import pwd
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoexec.sim.ports import free_udp_port
from tests.repository import ROOT
from tests.system.systemd import CONFIG, LEFT, STATE, UNIT, nothing_left, running, sh, show, wait, why_not

REPOSITORY = str(ROOT)
EDITED = "# edited by the administrator of this machine\n"
NO_INDEX = {"PIP_INDEX_URL": "http://127.0.0.1:1/", "PIP_RETRIES": "0", "PIP_NO_CACHE_DIR": "1"}

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "runs")


@pytest.fixture(scope="module", autouse=True)
def machine() -> Iterator[None]:
    yield
    sh("make", "-C", REPOSITORY, "uninstall", "ARGS=purge", check=False)


def test_installed_and_enabled_it_runs() -> None:
    sh("make", "-C", REPOSITORY, "install")
    assert show("ActiveState") == "inactive", "nobody has asked for it yet"
    sh("panoexec", "check-config", str(CONFIG))
    CONFIG.write_text(f'{EDITED}[vehicle]\nconnection = "udpin://127.0.0.1:{free_udp_port()}"\n')
    sh("systemctl", "enable", "--now", UNIT)
    wait("started", running)
    account = pwd.getpwnam("panoexec")
    assert (STATE.stat().st_uid, STATE.stat().st_mode & 0o777) == (account.pw_uid, 0o750)
    assert (CONFIG.parent.stat().st_gid, CONFIG.parent.stat().st_mode & 0o777) == (account.pw_gid, 0o750)
    assert Path("/usr").stat().st_mode & 0o777 == 0o755


def test_an_upgrade_keeps_the_configuration_and_starts_it_again() -> None:
    pid = show("MainPID")
    (STATE / "missions").mkdir(exist_ok=True)
    Path("/usr/lib/panoexec/of_an_old_version").touch()
    sh("make", "-C", REPOSITORY, "install")
    wait("started", running)
    assert show("MainPID") != pid
    assert CONFIG.read_text().startswith(EDITED)
    assert (STATE / "missions").is_dir()
    assert not Path("/usr/lib/panoexec/of_an_old_version").exists()


def test_an_upgrade_that_fails_changes_nothing() -> None:
    pid = show("MainPID")
    with pytest.raises(AssertionError, match="No matching distribution"):
        sh("make", "-C", REPOSITORY, "install", environment=NO_INDEX)
    assert show("MainPID") == pid
    assert sh("panoexec", "--version").startswith("panoexec ")


def test_removed_it_leaves_configuration_and_missions_purged_nothing() -> None:
    sh("make", "-C", REPOSITORY, "uninstall")
    assert show("ActiveState") == "inactive"
    assert CONFIG.read_text().startswith(EDITED)
    assert (STATE / "missions").is_dir()
    kept = {"/etc/panoexec", "/var/lib/panoexec"}
    assert [path for path in LEFT if Path(path).exists() or Path(path).is_symlink()] == sorted(kept)
    sh("make", "-C", REPOSITORY, "uninstall", "ARGS=purge")
    nothing_left()
    with pytest.raises(KeyError):
        pwd.getpwnam("panoexec")
