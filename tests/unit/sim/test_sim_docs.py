"""docs/simulator.md lists every parameter and every fault with its default."""

from __future__ import annotations

import re

from panoexec.sim import settings
from panoexec.sim.camera_kinds import CAMERA_KINDS
from panoexec.sim.config import SimConfig
from panoexec.sim.faults import FAULTS
from panoexec.sim.gimbal_kinds import GIMBAL_KINDS
from tests.repository import ROOT

TEXT = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
ROWS = {
    cells[1].strip().strip("`"): [cell.strip() for cell in cells[2:-1]]
    for cells in (line.split("|") for line in TEXT.splitlines() if line.startswith("| `"))
}


def test_every_number_is_documented_with_its_default() -> None:
    numbers = settings.names(SimConfig())
    documented = {name: row[0] for name, row in ROWS.items() if "." in name}
    expected = {n: str(v).lower() if isinstance(v, bool | str) else f"{v:.9g}" for n, v in numbers.items()}
    assert documented == expected
    assert all(row[1] for name, row in ROWS.items() if "." in name)


def test_every_fault_is_documented_with_its_text_and_size() -> None:
    documented = {name: row for name, row in ROWS.items() if name in FAULTS}
    assert set(documented) == set(FAULTS)
    for name, fault in FAULTS.items():
        assert documented[name][1] == fault.text
        assert documented[name][2] == (f"{fault.size:g} {fault.unit}" if fault.unit else "")


def kinds(heading: str) -> dict[str, str]:
    """Names and texts of the table below a heading."""
    section = TEXT[TEXT.index(f"## {heading}") :].split("\n## ", 1)[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| `")]
    return {name.strip("`"): text for name, text in rows}


def test_every_kind_of_camera_is_documented_with_its_text() -> None:
    assert kinds("Kinds of cameras") == {name: kind.text for name, kind in CAMERA_KINDS.items()}


def test_every_kind_of_gimbal_is_documented_with_its_text() -> None:
    assert kinds("Kinds of gimbals") == {name: kind.text for name, kind in GIMBAL_KINDS.items()}


def test_payloads_tell_what_panoexec_does_about_every_kind() -> None:
    text = (ROOT / "docs" / "payloads.md").read_text(encoding="utf-8")
    cameras, _, gimbals = text.partition("## Gimbals")
    for section, known in ((cameras, CAMERA_KINDS), (gimbals, GIMBAL_KINDS)):
        firsts = [line.strip("| ").split(" | ")[0] for line in section.splitlines() if line.startswith("| ")]
        named = {name for first in firsts for name in re.findall(r"[(,] ?`([a-z0-9-]+)`(?=[,)])", first)}
        assert set(known) <= named, set(known) - named
