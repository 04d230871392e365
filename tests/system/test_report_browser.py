"""The report in a real browser: no error, nothing fetched, the map turns and answers, the viewer starts.

Skipped where no Chromium is installed (apt-get install chromium).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from panoexec.report import write_report
from panoexec.report.data import page_data
from panoexec.report.page import render_page
from panoexec.report.source import read_source
from panoexec.store.directory import MissionDirectory
from tests.browser import Browser, chromium
from tests.report_missions import edit, photographed

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: apt-get install chromium")

BALL = "document.getElementById('ball')"
SHOT = "document.querySelector('.shot-card h3').textContent"
HOSTILE = "</script><script>window.harmed = 1</script><img src=x onerror='window.harmed = 2'>"


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> MissionDirectory:
    """A mission whose texts try to run scripts."""
    found = photographed(tmp_path_factory.mktemp("missions") / "20260921T141300.000Z", width_px=200)

    def spoil(document: dict[str, Any]) -> None:
        document |= {"reason": HOSTILE, "warnings": [HOSTILE], "vehicle": {HOSTILE: HOSTILE}}
        document["shots"][1]["attempts"][0]["reason"] = HOSTILE

    edit(found, spoil)
    write_report(found)
    return found


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as running:
        yield running


@pytest.fixture
def page(browser: Browser, directory: MissionDirectory) -> Browser:
    """The report at the width of a desktop; opened anew only where another page was, as that takes seconds."""
    if browser.value("document.title + innerWidth") != f"{directory.mission_id} · complete · panoexec1280":
        browser.show(width=1280)
        browser.open(directory.report)
    browser.until(f"{BALL}.dataset.paint === 'photos'")
    return browser


def middle(browser: Browser) -> tuple[float, float]:
    """Of the ball, in the window."""
    browser.value(f"{BALL}.scrollIntoView({{block: 'center', behavior: 'instant'}})")
    box = browser.value(
        f"(({{x, y, width, height}}) => [x + width / 2, y + height / 2])({BALL}.getBoundingClientRect())"
    )
    return float(box[0]), float(box[1])


def assert_sound(browser: Browser) -> None:
    assert browser.problems() == []
    assert browser.value("document.documentElement.dataset.errors || ''") == ""


def test_everything_is_drawn_and_nothing_is_fetched(page: Browser, directory: MissionDirectory) -> None:
    assert page.value("document.querySelector('h1').textContent") == f"Mission {directory.mission_id}"
    # three axes of eight attempts, one of them rejected
    assert page.value("document.querySelectorAll('#pointing .mark').length") == 24
    assert page.value("document.querySelectorAll('#timeline g.hit').length") == 8
    assert page.value("document.querySelectorAll('#retakes tbody tr').length") == 1
    assert page.value("document.querySelectorAll('#certificate .good-text').length") == 5
    assert page.value("document.querySelectorAll('#battery path').length") == 2
    assert [url for url in page.requests() if not url.startswith(("data:", "blob:"))] == [directory.report.as_uri()]
    assert_sound(page)


def test_texts_that_try_to_run_are_shown_and_do_not_run(page: Browser) -> None:
    assert HOSTILE in page.value("document.querySelector('#head p').textContent")
    assert HOSTILE in page.value("document.querySelector('#retakes').textContent")
    assert page.value("String(window.harmed)") == "undefined"


def test_the_map_turns_and_answers(page: Browser) -> None:
    x, y = middle(page)
    page.mouse("mouseMoved", x, y)
    page.until(f"{SHOT}.startsWith('Shot ')")
    first = page.value(SHOT)
    yaw = float(page.value(f"{BALL}.dataset.yaw"))
    page.mouse("mousePressed", x, y, buttons=1)
    for step in range(1, 6):
        page.mouse("mouseMoved", x - 40 * step, y, buttons=1)
    page.mouse("mouseReleased", x - 200, y)
    page.until(f"{BALL}.dataset.yaw !== '{yaw:.2f}'")
    # what was at the middle went with the pointer to the left: the map now looks further to the right
    turned = (float(page.value(f"{BALL}.dataset.yaw")) - yaw + 180) % 360 - 180
    assert 30 < turned < 70
    page.mouse("mouseMoved", x + 1, y)
    page.until(f"{SHOT}.startsWith('Shot ') && {SHOT} !== {first!r}")
    # a click keeps a shot; leaving the map does not let it go
    page.mouse("mousePressed", x, y, buttons=1)
    page.mouse("mouseReleased", x, y)
    kept = page.value(SHOT)
    page.mouse("mouseMoved", 2, 2)
    assert page.value(SHOT) == kept
    assert_sound(page)


def test_the_shot_of_a_retake_tells_both_attempts_and_opens_its_photo(page: Browser) -> None:
    page.value("document.querySelector('#timeline g.hit:nth-of-type(2)').dispatchEvent(new Event('click'))")
    text = page.until("document.querySelector('.shot-card').textContent")
    assert "Shot 1" in text
    assert "accepted at attempt 2" in text
    assert HOSTILE in text
    assert page.value("document.querySelector('.shot-card a').getAttribute('href')") == "./images/IMG_0001.jpg"
    assert page.value("document.querySelector('.shot-card a').href").startswith("file:///")


def test_keys_and_buttons(page: Browser) -> None:
    yaw = page.value(f"{BALL}.dataset.yaw")
    page.value(f"{BALL}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'ArrowRight'}}))")
    page.until(f"{BALL}.dataset.yaw !== {yaw!r}")
    for choice, what in (("map", "view"), ("coverage", "paint"), ("ball", "view"), ("photos", "paint")):
        page.value(f"document.querySelector('[data-choice={choice}]').click()")
        page.until(f"{BALL}.dataset.{what} === '{choice}'")
    assert_sound(page)


def test_the_keyboard_stays_on_the_button_that_goes_from_shot_to_shot(page: Browser) -> None:
    page.value("document.querySelector('[data-step=next]').focus()")
    shots = []
    for _ in range(3):
        page.value("document.activeElement.click()")
        shots.append(page.value(SHOT))
        assert page.value("document.activeElement.dataset.step") == "next"
    assert len(set(shots)) == 3
    page.value("document.querySelector('[data-step=let-go]').focus()")
    page.value("document.activeElement.click()")
    assert page.value("document.activeElement.dataset.step") == "previous", "let go is gone: the next best button"
    page.value("document.querySelector('[data-choice=map]').focus()")
    page.value("document.querySelector('[data-step=next]').click()")
    assert page.value("document.activeElement.dataset.choice") == "map", "the focus is taken from nobody"
    assert_sound(page)


def test_the_viewer_starts_with_a_spot_for_each_photo(page: Browser) -> None:
    page.until("document.documentElement.dataset.viewer === 'loaded'")
    page.until("document.querySelectorAll('#viewer .pnlm-shot').length === 7")
    links = page.value("[...document.querySelectorAll('#viewer a[data-shot]')].map((a) => a.getAttribute('href'))")
    assert sorted(links) == [f"./images/IMG_{k:04d}.jpg" for k in range(7)]
    sizes = page.value(
        "[...document.querySelectorAll('#viewer .pnlm-shot')].map((s) => [s.offsetWidth, s.offsetHeight])"
    )
    assert min(min(size) for size in sizes) >= 24, "a finger meets them"
    assert_sound(page)


def test_on_a_phone_nothing_sticks_out_light_and_dark(page: Browser, directory: MissionDirectory) -> None:
    page.show(width=390, phone=True)
    page.open(directory.report)
    for dark in (False, True):
        page.show(width=390, dark=dark, phone=True)
        page.until(f"matchMedia('(prefers-color-scheme: dark)').matches === {str(dark).lower()}")
        assert page.value("document.documentElement.scrollWidth") == 390
        ink = page.value("getComputedStyle(document.body).color.match(/\\d+/)[0]")
        assert (int(ink) > 128) == dark
    assert_sound(page)


def test_a_mission_without_anything(browser: Browser, directory: MissionDirectory, tmp_path: Path) -> None:
    bare = photographed(tmp_path / "20260921T150000.000Z", width_px=32)

    def nothing(document: dict[str, Any]) -> None:
        for shot in document["shots"]:
            shot.update(attempts=[], accepted_attempt=None, status="pending", file="")
        document |= {"state": "failed", "certificate": None, "battery": [], "times": {}}

    edit(bare, nothing)
    bare.plan.unlink()
    write_report(bare)
    browser.show(width=1280)
    browser.open(bare.report)
    assert "0 of 7" in browser.value("document.querySelector('#tiles').textContent")
    assert "no usable photos" in browser.value("document.querySelector('#photos').textContent")
    assert_sound(browser)


def test_without_webgl_the_panorama_is_a_flat_picture_and_foreign_scripts_do_not_run(
    directory: MissionDirectory, tmp_path: Path
) -> None:
    with Browser(tmp_path, webgl=False) as browser:
        browser.show(width=1280)
        browser.open(directory.report)
        browser.until("document.querySelector('#viewer img').complete")
        assert browser.value("document.querySelector('#viewer img').naturalWidth") == 2048
        browser.until(f"{BALL}.dataset.paint === 'photos'")
        assert_sound(browser)
        added = "Object.assign(document.createElement('script'), {textContent: 'window.harmed = 3'})"
        browser.value(f"document.body.append({added})")
        assert browser.value("String(window.harmed)") == "undefined"


@pytest.mark.parametrize("simulated", [True, False])
def test_times_are_told_for_who_reads_and_simulated_ones_as_such(
    simulated: bool,
    browser: Browser,
    directory: MissionDirectory,
    tmp_path: Path,
) -> None:
    source = read_source(directory)
    data = page_data(replace(source, simulated=simulated), made_utc_s=0.0) | {"panorama": {"kind": None}}
    data["timeline"] |= {"lived_s": 40.0, "pace": 10.0 if simulated else 1.0}
    page = tmp_path / "report.html"
    page.write_text(render_page(data, None))
    browser.call("Emulation.setTimezoneOverride", timezoneId="Asia/Kolkata")
    try:
        browser.open(page)
        facts = browser.value("document.querySelector('#facts').textContent")
        assert browser.value("document.querySelector('#foot').textContent").count(" UTC (") == 1
        assert browser.value("when('2026-09-21T20:30:00.5Z')") in (
            "2026-09-21 20:30:00 UTC (02:00 AM local)",
            "2026-09-21 20:30:00 UTC (02:00 local)",
        )
        assert ("duration40.0 s of simulated time, 4.0 s on the clock" in facts) is simulated
        tiles = browser.value("document.querySelector('#tiles').textContent")
        assert ("shooting time, simulated" in tiles) is simulated
        assert_sound(browser)
    finally:
        browser.call("Emulation.setTimezoneOverride", timezoneId="")
