"""The HTML page: one file with its data, images, styles and scripts embedded; it loads nothing.

All texts of the mission are in a JSON block whose `<`, `>` and `&` are escaped, and the scripts insert them as text,
never as markup. A content security policy with the scripts' digests prevents other scripts from running.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

from panoexec.report.panorama import Panorama

_SHARED_SCRIPTS: Final = ("elements.js", "sphere_math.js", "sphere_view.js")
"""Modules that the operator's page loads as they are, in an order in which each finds what it imports."""
_MODULE_WORDS: Final = re.compile(r"^(?:import [^\n]*;\n|export )", re.MULTILINE)
_SCRIPTS: Final = ("core.js", "sphere.js", "charts.js", "viewer.js", "main.js")
_VIEWER_SCRIPTS: Final = ("pannellum/libpannellum.js", "pannellum/pannellum.js")


def render_page(data: Mapping[str, Any], panorama: Panorama | None) -> str:
    """The HTML.

    Args:
        data: from `page_data`, with the key `panorama` that describes the picture.
        panorama: the panorama, if there is one.
    """
    own = (*_VIEWER_SCRIPTS, *_SCRIPTS) if panorama else _SCRIPTS
    scripts = [*(shared_script(name) for name in _SHARED_SCRIPTS), *(asset(name) for name in own)]
    styles = shared_asset("theme.css") + asset("report.css") + (viewer_styles() if panorama else "")
    policy = policy_for(scripts)
    mission, counts = data["mission"], data["counts"]
    summary = f"{mission['state']}: {counts['shots_done']} of {counts['shots_total']} shots. {mission['reason']}"
    parts = {
        "policy": html.escape(policy, quote=True),
        "title": html.escape(f"{mission['name'] or mission['id']} · {mission['state']} · panoexec"),
        "noscript": html.escape(summary),
        "style": f"<style>{styles}</style>",
        "data": f'<script type="application/json" id="data">{embedded_json(data)}</script>',
        "picture": _picture(panorama),
        "scripts": "\n".join(f"<script>{script}</script>" for script in scripts),
    }
    # one pass: inserted text is not searched for placeholders
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], asset("page.html"))


def policy_for(scripts: Sequence[str]) -> str:
    """The content security policy of a page that runs these scripts and loads nothing."""
    digests = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    return (
        f"default-src 'none'; script-src {digests}; style-src 'unsafe-inline'; img-src data: blob:;"
        " connect-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def embedded_json(data: object) -> str:
    """JSON that is safe inside a script element."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


@cache
def asset(name: str) -> str:
    """A text file of the package's assets; it must not contain a script end tag."""
    return (files("panoexec.report") / "assets" / name).read_text(encoding="utf-8")


@cache
def shared_asset(name: str) -> str:
    """A text file that the report shares with the operator's page."""
    return (files("panoexec") / "pages" / name).read_text(encoding="utf-8")


def shared_script(name: str) -> str:
    """A shared module as a classic script: a page that is a file cannot load modules, so all names are global in it."""
    return _MODULE_WORDS.sub("", shared_asset(name))


def _digest(script: str) -> str:
    # browsers compute the digest after normalising newlines
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _picture(panorama: Panorama | None) -> str:
    if panorama is None:
        return ""
    coded = base64.b64encode(panorama.jpeg).decode()
    return f'<script type="text/plain" id="panorama-jpeg">{coded}</script>'


@cache
def viewer_styles() -> str:
    """The viewer's styles with embedded images."""

    def inline(match: re.Match[str]) -> str:
        coded = base64.b64encode(asset(f"pannellum/{match[1]}").encode()).decode()
        return f"url('data:image/svg+xml;base64,{coded}')"

    return re.sub(r"url\('(img/\w+\.svg)'\)", inline, asset("pannellum/pannellum.css"))
