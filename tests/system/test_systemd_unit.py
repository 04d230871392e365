"""The shipped unit: how exposed it leaves the service, as systemd itself judges."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.repository import ROOT

UNITS = ROOT / "systemd"

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def exposure(folder: Path, *drop_ins: str, name: str = "panoexec.service") -> float:
    unit = Path(shutil.copy(UNITS / name, folder))
    drop_in = folder / f"{name}.d"
    shutil.rmtree(drop_in, ignore_errors=True)
    drop_in.mkdir()
    for one in drop_ins:
        shutil.copy(UNITS / one, drop_in)
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(rf"Overall exposure level for {name}: ([\d.]+)", out)
    assert found is not None, out
    return float(found[1])


def test_exposure(tmp_path: Path) -> None:
    alone = exposure(tmp_path)
    assert alone <= 1.5
    # a drop-in opens devices, so it must show
    assert alone < exposure(tmp_path, "serial.conf") <= 1.5
    assert alone < exposure(tmp_path, "gphoto2.conf") <= 2.0
    assert alone < exposure(tmp_path, "gphoto2.conf", "serial.conf") <= 2.0


def test_the_page_is_shut_in_as_the_daemon_is_and_yields_to_it(tmp_path: Path) -> None:
    assert exposure(tmp_path, name="panoexec-web.service") <= 1.5
    daemon, page = ((UNITS / name).read_text(encoding="utf-8") for name in ("panoexec.service", "panoexec-web.service"))
    for setting, more in (("Nice", 1), ("OOMScoreAdjust", 1), ("CPUWeight", -1)):
        values = [int(re.search(rf"^{setting}=(-?\d+)$", unit, re.MULTILINE)[1]) for unit in (daemon, page)]  # type: ignore[index]
        assert more * values[1] > more * values[0], setting
    # a failure of one must not stop the other
    assert not re.search(r"^(Requires|BindsTo|PartOf|Requisite)=", page, re.MULTILINE)


def test_the_page_is_off_until_it_is_enabled() -> None:
    postinst = (ROOT / "packaging" / "debian" / "postinst").read_text(encoding="utf-8")
    assert "enable panoexec-web" not in postinst
    assert "is-enabled --quiet panoexec-web.service" in postinst
