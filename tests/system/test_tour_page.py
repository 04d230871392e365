"""The page of a tour in a real browser: the map, the list, hops from panorama to panorama; nothing is fetched or run.

Skipped where no Chromium is installed (apt-get install chromium).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from panoexec.report import write_report
from panoexec.report.tour import write_tour_report
from panoexec.store.tours import Stop, Tour, tours_folder, write_tour
from tests.browser import Browser, chromium
from tests.report_missions import edit, photographed

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: apt-get install chromium")

TOUR_ID = "tour-20260921T141200.000Z"
HOSTILE = "</script><script>window.harmed = 1</script><img src=x onerror='window.harmed = 2'>"
IDS = ("20260921T141300.000Z", "20260921T141500.000Z")


def page_of(storage: Path) -> Path:
    """The page of a tour with two panoramas, 40 m apart, and a stop that was skipped."""
    for mission_id in IDS:
        directory = photographed(storage / "missions" / mission_id, width_px=200)
        edit(directory, lambda document: document.update(name=HOSTILE))
        write_report(directory)
    places = ((47.4, 8.5, IDS[0]), (47.4, 8.5 + 40 / 75_400, IDS[1]), (47.4003, 8.5, None))
    stops = tuple(
        Stop(
            number=number,
            waypoint=2 * number,
            preset="roof",
            latitude_deg=latitude,
            longitude_deg=longitude,
            mission_id=mission_id,
            outcome="complete" if mission_id else "skipped",
            reason=HOSTILE,
            arrived="2026-09-21T14:13:00.000Z",
        )
        for number, (latitude, longitude, mission_id) in enumerate(places, start=1)
    )
    write_tour(storage, Tour(tour_id=TOUR_ID, vehicle=HOSTILE, digest="ab", waypoints=(2, 4, 6), stops=stops))
    report = write_tour_report(tours_folder(storage) / f"{TOUR_ID}.json")
    assert (report.stops, report.complete, report.panoramas, report.notes) == (3, 2, 2, ())
    return report.path


def test_it_hops_from_panorama_to_panorama(tmp_path: Path) -> None:
    path = page_of(tmp_path)
    with Browser(tmp_path / "profile") as browser:
        browser.show(width=1280)
        browser.open(path)
        browser.until("document.documentElement.dataset.viewer === 'loaded'")
        assert browser.value("document.querySelector('h1').textContent") == "Tour 20260921T141200.000Z"
        assert browser.value("document.querySelectorAll('#map g.stop').length") == 3
        assert browser.value("document.querySelectorAll('#stops tbody tr').length") == 3
        links = "[...document.querySelectorAll('#stops a')].map((link) => link.getAttribute('href'))"
        assert browser.value(links) == [f"../missions/{mission_id}/report.html" for mission_id in IDS]
        # the other station is east of the first one, in the frame of the panorama
        hop = "viewer.getConfig().hotSpots.map((spot) => [spot.sceneId, Math.round(wrap(spot.yaw + stops[0].north))])"
        assert browser.value(hop) == [["2", 90]]
        assert browser.value("document.documentElement.dataset.stop") == "1"
        browser.value("document.querySelector('#map g.stop[data-number=\"2\"]').dispatchEvent(new MouseEvent('click'))")
        browser.until("document.documentElement.dataset.stop === '2' && viewer.getScene() === '2'")
        browser.value("document.querySelector('#map g.stop[data-number=\"3\"]').dispatchEvent(new MouseEvent('click'))")
        assert browser.value("document.documentElement.dataset.stop") == "2"
        assert browser.value("window.harmed === undefined")
        assert [url for url in browser.requests() if not url.startswith(("data:", "blob:"))] == [path.as_uri()]
        assert browser.problems() == []
