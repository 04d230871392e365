"""Planning on the operator's page in a real browser: drag a band, see what it costs, start what is shown.

Skipped where no Chromium is installed (apt-get install chromium).
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from tests.browser import Browser, chromium
from tests.support.page_missions import planned
from tests.support.page_server import PageServer, vehicle

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: apt-get install chromium")


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    with PageServer() as running:
        yield running


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as running:
        running.show(width=1280)
        yield running


def text(browser: Browser, selector: str) -> str:
    return str(browser.value(f"document.querySelector({json.dumps(selector)})?.innerText ?? ''"))


def test_a_band_is_dragged_and_what_is_shown_is_what_is_started(browser: Browser, server: PageServer) -> None:
    server.vehicles = {"drone": vehicle()}
    server.heard.clear()
    browser.show(width=1280)
    browser.visit(f"{server.url}/v/drone#plan")
    first = server.wait_for("command", command="plan")
    assert first["fields"] == {"shots": True}
    assert browser.value("document.getElementById('do-start').getAttribute('aria-disabled')") == "true"
    planned(server, first)
    browser.until("document.getElementById('certificate-line') !== null")
    assert text(browser, "#certificate-line").endswith("within 0.1° in pitch, 0.1° in roll and 0.7° in yaw.")
    for part in ("18", "1:05", "12 %"):
        assert part in text(browser, "#costs")
    handles = browser.until("document.getElementById('plan-ball').dataset.handles")
    box = browser.value("(({x, y}) => [x, y])(document.getElementById('plan-ball').getBoundingClientRect())")
    x, y = (at + edge for at, edge in zip(json.loads(handles)["high"], box, strict=True))
    browser.drag((x, y), (x, y + 60))
    # until the vehicle has answered, the old plan cannot be started
    assert browser.value("document.getElementById('do-start').getAttribute('aria-disabled')") == "true"
    high = int(browser.value("document.getElementById('n-high').value"))
    assert -30 < high < 25
    wanted = {"overlap": 0.15, "elevation_deg": [-90, high], "azimuth_deg": [-180, 180], "shots": True}
    request = server.wait_for("command", command="plan", fields=wanted)
    assert "about" in text(browser, "#costs")
    plan = planned(server, request)
    browser.until("document.getElementById('do-start').getAttribute('aria-disabled') === null")
    browser.value("document.getElementById('n-name').value = 'chapel'")
    browser.click("#do-start")
    server.wait_for("command", command="start", fields={"plan": plan, "name": "chapel"})
    assert browser.problems() == []


def test_a_plan_without_a_proof_asks_and_wrong_numbers_start_nothing(browser: Browser, server: PageServer) -> None:
    server.vehicles = {"drone": vehicle()}
    server.heard.clear()
    browser.show(width=1280)
    browser.visit(f"{server.url}/v/drone#plan")
    planned(server, server.wait_for("command", command="plan"), certified=False)
    browser.until("document.getElementById('certificate-line')?.innerText.includes('a hole of 3° remains')")
    browser.click("#do-start")
    browser.until("document.querySelector('dialog[open]') !== null")
    browser.key("Escape")
    browser.until("document.querySelector('dialog') === null")
    browser.value("(n => { n.value = '99'; n.dispatchEvent(new Event('input')); })(document.getElementById('n-high'))")
    browser.until("document.getElementById('n-high').getAttribute('aria-invalid') === 'true'")
    assert "Highest must be −90° to 90°." in text(browser, ".fields")
    browser.click("#do-start")
    assert not [one for one in server.heard if one.get("command") == "start"]


# ten thousand drags of any edge to any place: whatever comes of them can be planned, and moves no other edge
_DRAGS = """
(async () => {
  const { dragged, faults, handles } = await import("/assets/draft.js");
  let seed = 7, draft = { camera: "", overlap: 0.2, elevation: [-90, 30], azimuth: [-180, 180] };
  const random = () => { seed = (seed * 1103515245 + 12345) % 2147483648; return seed / 2147483648; };
  const wrong = [], turn = (a) => ((a % 360) + 360) % 360;
  for (let k = 0; k < 10000; k += 1) {
    if (k % 500 === 0) draft = { ...draft, elevation: [-90, 30], azimuth: k % 1000 ? [-180, 180] : [100, 260] };
    const places = handles(draft, random() * 360 - 180), { edge } = places[Math.floor(random() * places.length)];
    const next = dragged(draft, edge, random() * 200 - 100, random() * 360 - 180);
    const same = {
      high: next.elevation[0] === draft.elevation[0] && String(next.azimuth) === String(draft.azimuth),
      low: next.elevation[1] === draft.elevation[1] && String(next.azimuth) === String(draft.azimuth),
      right: next.azimuth[0] === draft.azimuth[0] && String(next.elevation) === String(draft.elevation),
      left: turn(next.azimuth[1]) === turn(draft.azimuth[1]) && String(next.elevation) === String(draft.elevation),
    }[edge];
    if (!same || Object.keys(faults(next)).length) wrong.push([edge, draft, next, faults(next)]);
    draft = next;
  }
  return wrong.slice(0, 3);
})()
"""


def test_no_drag_makes_a_band_that_cannot_be_planned(browser: Browser, server: PageServer) -> None:
    browser.visit(f"{server.url}/login")
    assert browser.value(_DRAGS) == []


_WHO_COMES_FIRST = """
(async () => {
  const { headline, urgency } = await import("/assets/model.js");
  const { actions } = await import("/assets/actions.js");
  const links = { autopilot: { ok: true, age_s: 0 }, gimbal: { ok: true, age_s: 0 }, camera: { ok: true, age_s: 0 } };
  const common = { shots_total: 4, link: links, reason: "", resumable: null, mission_id: "m" };
  const of = (state, more) => ({ status: "online", may: {}, marks: "", state: { ...common, state, ...more } });
  const states = ["preflight", "capturing", "paused", "finishing", "complete", "incomplete", "aborted", "failed"];
  const cases = [of("idle"), of("idle", { resumable: "m" }), ...states.map((state) => of(state))];
  return cases.map((one) => {
    const { primary, abort } = actions(one, "operator", false);
    return [headline(one).word, urgency(one), primary.command, Boolean(abort)];
  });
})()
"""


def test_every_state_has_its_word_and_its_next_step(browser: Browser, server: PageServer) -> None:
    browser.visit(f"{server.url}/login")
    assert browser.value(_WHO_COMES_FIRST) == [
        ["Ready", 3, "open-plan", False],
        ["Interrupted", 1, "resume", True],
        ["Checking", 2, "pause", True],
        ["Taking photos", 2, "pause", True],
        ["Paused", 1, "resume", True],
        ["Finishing", 2, "pause", True],
        ["Complete", 3, "open-result", False],
        ["Incomplete", 1, "open-result", False],
        ["Aborted", 0, "open-result", False],
        ["Failed", 0, "open-result", False],
    ]
