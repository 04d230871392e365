"""The operator's page in a real browser, against a server that says what the test wants.

Skipped where no Chromium is installed (apt-get install chromium).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.browser import Browser, chromium
from tests.support.accessibility import problems
from tests.support.page_missions import jpeg, midway, planned, taken
from tests.support.page_server import MISSION, PageServer, links, state, vehicle

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: apt-get install chromium")

HOSTILE = "</script><script>window.harmed = 1</script><img src=x onerror='window.harmed = 2'>"
BALL = "document.getElementById('ball').dataset"
WORD = "document.getElementById('state-word').textContent"


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    with PageServer() as running:
        running.thumbnail = jpeg()
        yield running


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as running:
        running.show(width=1280)
        yield running


@pytest.fixture
def page(browser: Browser, server: PageServer) -> Browser:
    """The page of a vehicle in the middle of a mission."""
    server.vehicles = {"drone": midway()}
    server.beating = True
    server.heard.clear()
    browser.show(width=1280)
    browser.visit(f"{server.url}/v/drone")
    return browser


def text(browser: Browser, selector: str) -> str:
    return str(browser.value(f"document.querySelector({json.dumps(selector)})?.innerText ?? ''"))


def assert_sound(browser: Browser) -> None:
    assert browser.problems() == []
    assert browser.value("document.documentElement.dataset.errors || ''") == ""


def test_the_mission_is_on_the_sphere_and_in_words(page: Browser, server: PageServer) -> None:
    page.until(f"{BALL}.photos === '2' && Number({BALL}.laid) > 2")
    assert json.loads(page.value(f"{BALL}.standings")) == {
        "done": 1,
        "retaken": 1,
        "current": 1,
        "again": 1,
        "missing": 1,
        "todo": 13,
    }
    assert page.value(f"{BALL}.ties") == "1"
    assert page.value(f"{BALL}.measured") == "2"
    assert page.value(WORD) == "Taking photos"
    told = text(page, "[aria-label=Progress]")
    for part in ("2", "of 18", "1:35", "71 %", "needs 34 %", "1 done", "1 retaken", "1 missing", "13 planned"):
        assert part in told
    assert "moved 0.4° during the exposure" in text(page, ".log li")
    assert {url.split("/")[2] for url in page.requests() if url.startswith("http")} == {server.url.split("/")[2]}
    assert_sound(page)


def test_what_happens_is_shown_as_it_happens(page: Browser, server: PageServer) -> None:
    told = midway()
    shot = told["mission"]["shots"][2]
    taken(shot, ties=(1,), url=f"/thumbnails/drone/{MISSION}/2?n=b")
    paused = told["state"] | {
        "state": "paused",
        "reason": "battery at 20 %, floor 25 %: land",
        "shots_done": 3,
        "link": links(lost="camera"),
    }
    event = {
        "seq": 9,
        "time": "2026-11-30T10:01:00Z",
        "kind": "mission_paused",
        "code": "battery",
        "level": "warning",
        "text": "Paused: battery",
        "shot": None,
        "attempt": None,
    }
    server.say(
        {"type": "shot", "vehicle": "drone", "mission_id": MISSION, "shot": shot},
        {"type": "event", "vehicle": "drone", "mission_id": MISSION, "event": event},
        {
            "type": "state",
            "vehicle": "drone",
            "state": paused,
            "may": told["may"] | {"pause": "the mission is paused already", "resume": ""},
            "marks": "drdam" + 13 * "t",
        },
    )
    page.until(f"{WORD} === 'Paused' && {BALL}.photos === '3' && {BALL}.ties === '2'")
    assert "Battery at 20 %, floor 25 %: land." in text(page, ".state")
    assert "swap the battery" in text(page, ".advice")
    assert text(page, ".light.off") == "camera lost"
    assert text(page, ".actions .primary") == "Resume"
    assert_sound(page)


def test_a_late_page_is_the_same_as_one_that_was_there(page: Browser, server: PageServer) -> None:
    told = midway()
    shot = told["mission"]["shots"][5]
    taken(shot, ties=(0, 1), retaken=True)
    told["state"] |= {"shots_done": 3, "retakes": 2}
    told["marks"] = "drcamr" + 12 * "t"
    server.say(
        {"type": "shot", "vehicle": "drone", "mission_id": MISSION, "shot": shot},
        {"type": "state", "vehicle": "drone", "state": told["state"], "may": told["may"], "marks": told["marks"]},
    )
    seen = f"JSON.stringify([document.querySelector('main').innerText, {BALL}.standings, {BALL}.ties])"
    page.until(f"{BALL}.ties === '3' && JSON.parse({BALL}.standings).retaken === 2")
    before = page.value(seen)
    server.vehicles = {"drone": told}
    page.visit(f"{server.url}/v/drone")
    page.until(f"{BALL}.ties === '3' && JSON.parse({BALL}.standings).retaken === 2")
    assert page.value(seen) == before


def test_a_page_that_hears_nothing_is_grey_within_3_s_and_heals(page: Browser, server: PageServer) -> None:
    server.beating = False
    # in quarters of a second in which the page could act: a browser that gets no processor time has none
    page.value(
        "window.quarters = 0, window.greyed = null,"
        " setInterval(() => { if (document.documentElement.dataset.lost !== 'yes') window.quarters += 1;"
        " else window.greyed = true; }, 250), 0"
    )
    page.until("window.greyed !== null")
    # the last beat may have come just after; a frame and the page's own check each quarter of a second
    assert page.value("window.quarters") <= 4 * 3.9
    assert "No connection to the server since" in text(page, "#lost")
    assert page.value("getComputedStyle(document.querySelector('main')).filter") == "grayscale(1)"
    assert page.value("document.getElementById('do-pause').getAttribute('aria-disabled')") == "true"
    changed = midway()
    changed["state"]["state"] = "finishing"
    server.vehicles = {"drone": changed}
    server.beating = True
    server.hang_up()
    page.until(f"document.documentElement.dataset.lost === 'no' && {WORD} === 'Finishing'")
    assert page.value("document.getElementById('lost').hidden")


def test_a_command_that_was_not_answered_is_repeated_with_its_id(page: Browser, server: PageServer) -> None:
    page.click("#do-pause")
    sent = server.wait_for("command", command="pause")
    server.hang_up()
    again = server.wait_for("command", command="pause")
    assert again == sent
    server.say(
        {
            "type": "answer",
            "id": sent["id"],
            "vehicle": "drone",
            "command": "pause",
            "stage": "done",
            "error": None,
            "data": {},
        }
    )
    page.until("document.getElementById('toasts').innerText.includes('pause: done')")
    server.hang_up()
    server.wait_for("follow", vehicle="drone")
    page.until("document.documentElement.dataset.lost === 'no'")
    assert not [one for one in server.heard if one["type"] == "command"]


def test_a_command_of_long_ago_is_not_repeated(page: Browser, server: PageServer) -> None:
    page.click("#do-pause")
    server.wait_for("command", command="pause")
    page.value("Date.now = ((now) => () => now() + 60000)(Date.now), 0")
    server.hang_up()
    server.wait_for("follow", vehicle="drone")
    page.until("document.getElementById('toasts').innerText.includes('look at the state, then command again')")
    assert not [one for one in server.heard if one["type"] == "command"]


def test_abort_asks_once_and_cancel_sends_nothing(page: Browser, server: PageServer) -> None:
    page.click("#do-abort")
    page.until("document.querySelector('dialog[open]') !== null")
    assert "cannot be resumed. 2 photos stay." in text(page, "dialog")
    assert page.value("document.activeElement.textContent") == "Cancel"
    page.key("Enter")
    page.until("document.querySelector('dialog') === null")
    page.key("x")
    page.click("#answer-yes")
    server.wait_for("command", command="abort", vehicle="drone", fields={})
    assert not [one for one in server.heard if one["type"] == "command"]


def test_what_cannot_be_done_is_greyed_with_its_reason_and_sends_nothing(page: Browser, server: PageServer) -> None:
    told = midway()
    told["may"]["finish"] = "the mission is finishing"
    server.say(
        {"type": "state", "vehicle": "drone", "state": told["state"], "may": told["may"], "marks": told["marks"]}
    )
    page.until("document.querySelector('.why').innerText.includes('Finish: the mission is finishing.')")
    assert page.value("document.getElementById('do-finish').getAttribute('aria-disabled')") == "true"
    page.click("#do-finish")
    page.click("#do-pause")
    server.wait_for("command", command="pause")
    assert page.value("document.querySelector('dialog')") is None
    assert not [one for one in server.heard if one["type"] == "command"]


def test_a_viewer_commands_nothing(page: Browser, server: PageServer) -> None:
    server.say(server.first[0] | {"role": "viewer"})
    page.until("document.getElementById('do-pause').getAttribute('aria-disabled') === 'true'")
    assert "viewer" in text(page, ".why")


def test_two_operators_see_each_other(page: Browser, server: PageServer) -> None:
    entry: dict[str, Any] = {
        "id": "abcdefgh",
        "time": "2026-11-30T10:02:00Z",
        "who": "TABLET-2",
        "vehicle": "drone",
        "command": "pause",
        "fields": {},
        "stage": "sent",
        "error": None,
    }
    server.say({"type": "log", "vehicle": "drone", "entry": entry})
    page.until("document.getElementById('stage').innerText.startsWith('sent')")
    server.say({"type": "log", "vehicle": "drone", "entry": entry | {"stage": "done"}})
    page.until("document.getElementById('stage').innerText.startsWith('done')")
    assert "TABLET-2" in text(page, "#stage")
    assert "TABLET-2: pause – done" in text(page, ".log")
    assert text(page, ".log").count("TABLET-2") == 1


def test_a_tapped_footprint_shows_its_photo_and_can_be_repeated(page: Browser, server: PageServer) -> None:
    page.value("document.getElementById('ball').focus()")
    page.key("j")
    page.key("j")
    page.until(f"{BALL}.chosen === '1'")
    told = text(page, ".shot")
    for part in (
        "Shot 1",
        "retaken",
        "roll error",
        "±0.7°",
        "102 % of its neighbours",
        "0 (40 points)",
        "attempt 1",
        "moved 0.4° during the exposure",
    ):
        assert part in told
    assert page.value("document.querySelector('.shot img').getAttribute('src')") == f"/thumbnails/drone/{MISSION}/1?n=a"
    page.click("#shot-repeat")
    server.wait_for("command", command="repeat", fields={"shot": 1})
    page.key("Escape")
    page.until("document.querySelector('.shot').hidden")
    # a tap in the middle of the sphere
    page.value("document.querySelector('[aria-label=\"Map\"] .plain').click()")
    x, y = page.middle("#ball")
    page.mouse("mousePressed", x, y, buttons=1)
    page.mouse("mouseReleased", x, y)
    page.until(f"{BALL}.chosen !== ''")
    assert_sound(page)


def test_texts_that_try_to_run_are_shown_and_do_not_run(page: Browser, server: PageServer) -> None:
    told = midway()
    told["state"] |= {"name": HOSTILE, "reason": HOSTILE, "content": {HOSTILE: 1}}
    told["mission"]["events"][0]["text"] = HOSTILE
    told["mission"]["shots"][0]["attempts"][0]["content"]["reason"] = HOSTILE
    told["mission"]["shots"][0]["reason"] = HOSTILE
    told["may"]["pause"] = HOSTILE
    told["log"] = [
        {
            "id": "abcdefgh",
            "time": HOSTILE,
            "who": HOSTILE,
            "vehicle": "drone",
            "command": "pause",
            "fields": {},
            "stage": "refused",
            "error": {"code": "x", "message": HOSTILE, "field": None},
        }
    ]
    server.vehicles = {"drone": told, "other": vehicle("other", state=state(name=HOSTILE, reason=HOSTILE))}
    page.visit(f"{server.url}/v/drone")
    page.until(f"Number({BALL}.shots) > 0")
    page.key("j")
    page.until(f"{BALL}.chosen === '0'")
    page.until("document.querySelector('h1').innerText.includes('<script>')")
    page.visit(f"{server.url}/#")
    page.until("document.querySelectorAll('#vehicles > li').length === 2")
    assert page.value("window.harmed") is None
    assert page.value("document.querySelectorAll('img[src=x], main script').length") == 0
    assert_sound(page)


def stored(mission_id: str, **fields: Any) -> dict[str, Any]:
    """A mission of the list."""
    return {
        "mission_id": mission_id,
        "name": HOSTILE,
        "state": "complete",
        "shots_total": 18,
        "shots_done": 18,
        "photos": 18,
        "size_bytes": 5_400_000,
        "problem": "",
        "report": None,
        "panorama": None,
        "preview": None,
        "download": f"/missions/{mission_id}/download",
        "deletable": "",
        "stitch": "",
        "place": {"latitude_deg": 47.3977, "longitude_deg": -8.5456},
        "time": "2026-11-30T10:00:00Z",
    } | fields


def test_missions_are_listed_stitched_and_deleted(page: Browser, server: PageServer) -> None:
    other = "20261129T100000.000Z"
    server.missions = [stored(MISSION), stored(other, name="", state="capturing", deletable="only finished missions")]
    page.visit(f"{server.url}/v/drone#missions")
    page.until("document.querySelectorAll('#missions > li').length === 2")
    assert "47.3977° N, 8.5456° W" in text(page, "#missions > li")
    page.click(f"[data-mission='{other}']")
    page.until("document.getElementById('delete')?.getAttribute('aria-disabled') === 'true'")
    assert "Delete: only finished missions." in text(page, "main")
    page.click("[data-key=back]")
    page.click(f"[data-mission='{MISSION}']")
    page.click("#stitch")
    server.wait_for("stitch", mission_id=MISSION)
    running = {"type": "stitch", "mission_id": MISSION, "stage": "running", "fraction": 0.4, "text": "blending"}
    server.say(running | {"who": "TABLET-2"})
    page.until("document.querySelector('#stitching progress')?.value === 0.4")
    assert "blending · TABLET-2" in text(page, "#stitching")
    assert problems(page) == []
    server.say(running | {"stage": "done", "fraction": 1.0, "text": "", "who": "TABLET-2"})
    page.until("document.getElementById('stitching').innerText.includes('stitched')")
    page.click("#delete")
    page.click("#answer-yes")
    page.until("document.querySelectorAll('#missions > li').length === 1")
    assert server.deleted == [(MISSION, MISSION)]
    assert page.value("window.harmed") is None
    assert_sound(page)


def test_a_report_that_is_written_after_the_mission_is_complete_appears(page: Browser, server: PageServer) -> None:
    server.missions = [stored(MISSION, report=None)]
    page.visit(f"{server.url}/v/drone#mission={MISSION}")
    page.until("document.getElementById('mission-state')?.textContent === 'Complete'")
    assert page.value("document.querySelector('iframe.report')") is None
    assert "a download does not have it" in text(page, "#report-awaited")
    server.missions = [stored(MISSION, report=f"/missions/{MISSION}/report")]
    page.until("document.querySelector('iframe.report') !== null && document.getElementById('open-report') !== null")
    assert page.value("document.getElementById('report-awaited')") is None


def test_a_fleet_is_sorted_by_who_needs_somebody(browser: Browser, server: PageServer) -> None:
    fleet = {f"drone-{k:02d}": vehicle(f"drone-{k:02d}") for k in range(50)}
    fleet["drone-30"]["state"] = state(
        state="capturing", mission_id=MISSION, shots_total=18, shots_done=2, shots="d2 c1 t15"
    )
    fleet["drone-20"]["state"] = state(state="paused", mission_id=MISSION, reason="the pilot has taken over")
    fleet["drone-40"]["status"] = "offline"
    server.vehicles = fleet
    browser.visit(f"{server.url}/#")
    browser.until("document.querySelectorAll('#vehicles > li').length === 50")
    order = browser.value("[...document.querySelectorAll('#vehicles a')].slice(0, 4).map((a) => a.dataset.vehicle)")
    assert order == ["drone-40", "drone-20", "drone-30", "drone-00"]
    back = fleet["drone-40"]
    server.say(
        {
            "type": "summaries",
            "vehicles": [{"id": "drone-40", "status": "online", "state": back["state"], "silent_s": 0}],
        }
    )
    browser.until("document.querySelector('#vehicles a').dataset.vehicle === 'drone-20'")
    browser.click("#vehicles a")
    server.wait_for("follow", vehicle="drone-20")
    browser.until(f"location.pathname === '/v/drone-20' && {WORD} === 'Paused'")
    assert_sound(browser)


@pytest.mark.parametrize(("width", "dark"), [(390, True), (820, False), (1280, True)])
def test_everybody_can_use_it(page: Browser, server: PageServer, width: int, dark: bool) -> None:
    page.show(width=width, dark=dark, phone=width < 500)
    server.vehicles = {"drone": midway(), "other": vehicle("other", status="offline")}
    page.visit(f"{server.url}/v/drone")
    page.until(f"Number({BALL}.shots) > 0")
    page.key("j")
    page.until(f"{BALL}.chosen === '0'")
    found = {"live": problems(page)}
    page.key("?")
    page.until("document.getElementById('help') !== null")
    found["help"] = problems(page)
    page.key("Escape")
    page.visit(f"{server.url}/v/drone#plan")
    planned(server, server.wait_for("command", command="plan"))
    page.until("document.getElementById('certificate-line') !== null")
    found["plan"] = problems(page)
    page.visit(f"{server.url}/#")
    page.until("document.querySelectorAll('#vehicles > li').length === 2")
    found["fleet"] = problems(page)
    page.visit(f"{server.url}/login?failed=wrong")
    assert "Name or password are wrong." in text(page, "form")
    found["login"] = problems(page)
    assert found == {name: [] for name in found}
