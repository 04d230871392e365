"""A whole mission flown by clicks: plan by dragging, start, pause, repeat, resume, complete, report, download, delete.

Broker, simulated vehicle, daemon and page are those of `panoexec demo`, each a process of its own. Skipped where no
Chromium is installed (apt-get install chromium), or no mosquitto.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import Browser, chromium
from tests.support.truth import untruths
from tests.waiting import eventually

pytestmark = [
    pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: apt-get install chromium"),
    pytest.mark.skipif(
        shutil.which("mosquitto") is None and not Path("/usr/sbin/mosquitto").exists(), reason="mosquitto is missing"
    ),
]

WORD = "document.getElementById('state-word')?.textContent"
BALL = "document.getElementById('ball').dataset"
ENABLED = "document.getElementById('{}')?.getAttribute('aria-disabled') === null"


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[str]:
    """The address of the page of a demo whose pace is that of the field, so that a busy browser can pause it."""
    command = [sys.executable, "-m", "panoexec", "demo", "--page-port", "0"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, encoding="utf-8"
    ) as process:
        try:
            said = ""
            assert process.stderr is not None
            for line in process.stderr:
                said += line
                if "Ctrl-C ends everything" in line:
                    break
            yield re.findall(r"http://\S+", said)[0]
            process.send_signal(signal.SIGINT)
            process.wait(60)
        finally:
            process.kill()  # its programs end with it


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    with Browser(tmp_path / "profile") as running:
        running.show(width=1280)
        yield running


def drag_handle(browser: Browser, edge: str, down_px: float) -> None:
    at = json.loads(browser.until("document.getElementById('plan-ball').dataset.handles"))[edge]
    browser.middle("#plan-ball")
    corner = browser.value("(({x, y}) => [x, y])(document.getElementById('plan-ball').getBoundingClientRect())")
    x, y = corner[0] + at[0], corner[1] + at[1]
    browser.drag((x, y), (x, y + down_px))


def plan_and_start(browser: Browser) -> int:
    """Number of images that the page showed before the start."""
    browser.click("#do-open-plan")
    browser.until("document.getElementById('certificate-line') !== null")
    drag_handle(browser, "high", 70)
    drag_handle(browser, "low", -60)
    low, high = (int(browser.value(f"document.getElementById('n-{edge}').value")) for edge in ("low", "high"))
    assert -90 < low < high < 30
    browser.until(f"document.getElementById('costs')?.dataset.fresh === 'yes' && {ENABLED.format('do-start')}")
    images = int(browser.value("document.querySelector('#costs .value').textContent"))
    browser.click("#n-name")
    browser.call("Input.insertText", text="Chapel <b>west</b>")
    browser.click("#do-start")
    return images


async def test_a_mission_is_flown_by_clicks(demo: str, browser: Browser, tmp_path: Path) -> None:
    browser.visit(demo)
    browser.until(f"{WORD} === 'Ready'")
    images = plan_and_start(browser)

    browser.until(f"JSON.parse({BALL}.standings).done >= 1 && {ENABLED.format('do-pause')}")
    browser.click("#do-pause")
    browser.until(f"{WORD} === 'Paused'")
    assert browser.value("document.querySelector('h1').textContent") == "Chapel <b>west</b> · demo"
    browser.key("j")
    browser.until(f"{BALL}.chosen === '0' && {ENABLED.format('shot-repeat')}")
    browser.click("#shot-repeat")
    browser.until("document.getElementById('stage').innerText.startsWith('done') && "
                  "document.getElementById('stage').innerText.includes('repeat shot 0')")  # fmt: skip
    browser.click("#do-resume")
    browser.until(f"{WORD} === 'Complete'")
    # every photo is on the sphere, the repeated one as a retake; a busy computer causes others
    browser.until(f"{BALL}.photos === '{images}' && !JSON.parse({BALL}.standings).current")
    standings = json.loads(browser.value(f"{BALL}.standings"))
    assert sum(standings.values()) == images
    assert browser.value("document.documentElement.dataset.errors || ''") == ""

    browser.click("#do-open-result")
    browser.until("document.getElementById('mission-state')?.textContent === 'Complete'")
    manifest = await downloaded(browser, tmp_path, images)
    # what a pause broke off before its photo is no try
    tries = [
        [a["verdict"] for a in one["attempts"] if a["number"] < one["accepted_attempt"]] for one in manifest["shots"]
    ]
    retaken = [earlier for earlier in tries if any(verdict != "interrupted" for verdict in earlier)]
    assert standings == {"done": images - len(retaken), "retaken": len(retaken)}
    address = browser.value("document.getElementById('open-report').href")
    browser.click("#delete")
    browser.click("#answer-yes")
    browser.until(
        "document.querySelector('.mission') === null && document.querySelector('main').innerText.includes('No mission')"
    )
    assert browser.problems() == []
    assert browser.value(f"fetch('{address}').then((answer) => answer.status)") == 404


async def downloaded(browser: Browser, tmp_path: Path, images: int) -> dict[str, Any]:
    """Download everything by clicks; what is said there is true. Returns the manifest."""
    folder = tmp_path / "downloads"
    # complete is told before the report is written
    browser.until("document.querySelector('iframe.report') !== null")
    browser.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    browser.click("#download")
    await eventually(lambda: list(folder.glob("*.zip")), 60)
    with zipfile.ZipFile(next(folder.glob("*.zip"))) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "here")
    (mission,) = (tmp_path / "here").iterdir()
    manifest: dict[str, Any] = json.loads((mission / "manifest.json").read_text())
    assert manifest["name"] == "Chapel <b>west</b>"
    assert manifest["state"] == "complete"
    assert len(manifest["shots"]) == images
    # the repeated shot; a busy computer may have had the first of its photos taken back before
    assert manifest["shots"][0]["accepted_attempt"] == len(manifest["shots"][0]["attempts"]) >= 2
    assert untruths(mission, tmp_path / "demo" / "photos" / "truth.jsonl") == []
    assert "<title>Chapel &lt;b&gt;west" in (mission / "report.html").read_text()
    frame = browser.value("document.querySelector('iframe.report').src")
    status = browser.value(f"fetch('{frame}').then((answer) => answer.text()).then((text) => text.length)")
    assert status == len((mission / "report.html").read_text())
    return manifest
