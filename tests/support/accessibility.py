"""What is wrong with a page for people who read it by ear, by keyboard, in the sun or with gloves.

`problems` is an own check of names, roles, contrast (WCAG 2.1: 4.5, or 3 for large text), sizes of targets and text,
and of what sticks out. `axe_problems` asks axe-core as well, where PANOEXEC_AXE names its script (axe.min.js).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from tests.browser import Browser

_CHECK = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


def problems(browser: Browser) -> list[str]:
    """One line a problem of what is shown now."""
    found = browser.value(_CHECK)
    return [str(one) for one in found] + axe_problems(browser)


def axe_problems(browser: Browser) -> list[str]:
    """The serious and critical findings of axe-core; empty where it is not there."""
    script = os.environ.get("PANOEXEC_AXE")
    if not script:
        return []
    if not browser.value("typeof axe === 'object'"):
        browser.value(Path(script).read_text(encoding="utf-8") + "; 0")
    rules = (
        "{runOnly: {type: 'tag', values: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']}}"
    )
    found: list[dict[str, Any]] = browser.value(
        f"axe.run(document, {rules}).then((r) => r.violations.map((v) => "
        "({id: v.id, impact: v.impact, nodes: v.nodes.map((n) => `${n.target} ${n.any[0]?.message || ''}`)})))"
    )
    return [
        f"axe {one['id']} ({one['impact']}): {one['nodes'][:4]}"
        for one in found
        if one["impact"] in {"serious", "critical"}
    ]
