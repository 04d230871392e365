"""The operator's page in a headless Chromium that draws by software: first view, turning the sphere, arriving photos.

The server is one of tests on loopback (`tests.support.page_server`); the mission has 155 shots with a thumbnail each.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.bench.harness import Measurement
from tests.browser import Browser
from tests.support.page_missions import flying, grid, jpeg, midway, taken
from tests.support.page_server import MISSION, PageServer

ROWS = ((-78.0, 8), (-60.0, 20), (-42.0, 28), (-24.0, 33), (-6.0, 33), (12.0, 33))
VIEWS = 5
TURNING_S = 6.0
THUMBNAILS = 40
BALL = "document.getElementById('ball').dataset"
_EACH_FRAME = """
(async () => {
  const times = [], ball = document.getElementById("ball");
  for (let k = 0; k < 40; k += 1) {
    const begun = performance.now();
    ball.dispatchEvent(new KeyboardEvent("keydown", { key: k % 2 ? "ArrowLeft" : "ArrowUp" }));
    await new Promise(requestAnimationFrame);
    times.push(performance.now() - begun);
  }
  return times;
})()
"""


def measure() -> Iterable[Measurement]:
    """All of them."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, PageServer() as server:
        server.thumbnail = jpeg(480, 360)
        with Browser(Path(folder), webgl=False) as browser:
            browser.show(width=1280)
            yield from _first_view(browser, server)
            yield from _turning(browser, server)
            yield from _arriving(browser, server)


def _first_view(browser: Browser, server: PageServer) -> Iterable[Measurement]:
    server.vehicles = {"drone": midway()}
    moments = []
    for _ in range(VIEWS):
        browser.visit(f"{server.url}/v/drone")
        browser.until(f"Number({BALL}.frames) >= 0 && performance.getEntriesByName('first-view').length > 0")
        moments.append(float(browser.value("performance.getEntriesByName('first-view')[0].startTime")) / 1000)
    sizes = browser.value(
        "performance.getEntriesByType('navigation').concat(performance.getEntriesByType('resource'))"
        ".filter((one) => !one.name.includes('/thumbnails/')).map((one) => one.decodedBodySize)"
    )
    yield Measurement(
        what=f"first view, median of {VIEWS}",
        ours=float(np.median(moments)),
        unit="s",
        goal="at most 1 s",
        met=bool(np.median(moments) <= 1),
    )
    yield Measurement(
        what="loaded for it, not compressed",
        ours=sum(sizes) / 1000,
        unit="kB",
        goal="at most 500 kB",
        met=sum(sizes) <= 500_000,
    )


def _turning(browser: Browser, server: PageServer) -> Iterable[Measurement]:
    shots = grid(ROWS)
    for one in shots:
        taken(one, url=f"/thumbnails/drone/{MISSION}/{one['i']}?n=a", ties=(max(0, one["i"] - 1),))
    server.vehicles = {"drone": flying(shots, "d" * len(shots))}
    begun = time.monotonic()
    browser.visit(f"{server.url}/v/drone")
    browser.until(f"{BALL}.photos === '{len(shots)}' && Number({BALL}.laid) > {len(shots)}")
    yield Measurement(
        what=f"{len(shots)} thumbnails on the sphere after the page was opened", ours=time.monotonic() - begun, unit="s"
    )
    x, y = browser.middle("#ball")
    browser.mouse("mousePressed", x, y, buttons=1)
    drawn, begun, k = int(browser.value(f"{BALL}.frames")), time.monotonic(), 0
    while time.monotonic() - begun < TURNING_S:
        k += 1
        browser.mouse("mouseMoved", x + 160 * np.sin(k / 9), y + 40 * np.sin(k / 14), buttons=1)
    took = time.monotonic() - begun
    frames = int(browser.value(f"{BALL}.frames")) - drawn
    browser.mouse("mouseReleased", x, y)
    yield Measurement(
        what="turning the sphere by the mouse",
        ours=frames / took,
        unit="frames/s",
        goal="at least 30",
        met=frames / took >= 30,
    )
    each = browser.value(_EACH_FRAME)
    yield Measurement(what="one frame at full resolution, median", ours=float(np.median(each)), unit="ms")


def _arriving(browser: Browser, server: PageServer) -> Iterable[Measurement]:
    shots = grid(ROWS)
    for one in shots[:THUMBNAILS]:
        taken(one)
    server.vehicles = {"drone": flying(shots, "d" * THUMBNAILS + "t" * (len(shots) - THUMBNAILS))}
    browser.visit(f"{server.url}/v/drone")
    took = []
    for k in range(THUMBNAILS):
        before = int(browser.until(f"{BALL}.laid"))
        begun = time.monotonic()
        url = f"/thumbnails/drone/{MISSION}/{k}?n=a"
        server.say({"type": "thumbnail", "vehicle": "drone", "mission_id": MISSION, "shot": k, "url": url})
        browser.until(f"Number({BALL}.laid) > {before} && {BALL}.photos === '{k + 1}'")
        took.append(time.monotonic() - begun)
    p95 = float(np.percentile(took, 95))
    yield Measurement(
        what=f"thumbnail told to be there until it is on the sphere, p95 of {THUMBNAILS}",
        ours=p95,
        unit="s",
        goal="at most 2 s",
        met=p95 <= 2,
    )
    standing = json.loads(browser.value(f"{BALL}.standings"))
    assert standing["done"] == THUMBNAILS
