"""The table of the doctor's findings."""

from __future__ import annotations

from rich import box
from rich.table import Table
from rich.text import Text

from panoexec.cli.output import console
from panoexec.doctor.findings import Findings, Verdict

_STYLES = {Verdict.OK: "green", Verdict.NOTE: "dim", Verdict.WARNING: "yellow", Verdict.MISSING: "bold red"}


def show_findings(findings: Findings) -> None:
    """Print the findings and what they add up to."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("check", no_wrap=True)
    table.add_column("")
    table.add_column("found, needed, advice")
    area = ""
    for finding in findings.all:
        if area and finding.area != area:
            table.add_section()
        area = finding.area
        text = Text(finding.found)
        if finding.verdict in (Verdict.WARNING, Verdict.MISSING) and finding.needed:
            text.append(f"\nneeded: {finding.needed}", style="dim")
        if finding.advice:
            text.append(f"\n→ {finding.advice}", style="bold")
        table.add_row(
            f"{finding.area}: {finding.check}", Text(finding.verdict.value, style=_STYLES[finding.verdict]), text
        )
    console().print(table)
    missing, warnings, fine = (findings.count(v) for v in (Verdict.MISSING, Verdict.WARNING, Verdict.OK))
    verdict = "ready for a mission" if findings.exit_code == 0 else "not ready for a mission"
    print(f"{missing} missing, {warnings} warning{'' if warnings == 1 else 's'}, {fine} ok: {verdict}")
