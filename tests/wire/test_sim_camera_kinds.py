"""Each kind of simulated camera behaves on the wire as the real class does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from panoexec.errors import UsageError
from panoexec.sim import settings
from panoexec.sim.camera_kinds import CAMERA_KINDS, with_camera_kind
from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.dialect import mavlink
from tests.wire.sim_peer import EmbeddedPeer, Heard, command, result_of

SHOOT, SET_MODE, REQUEST, DIGICAM = 2000, 530, 512, 203
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)


def peer_of(kind: str, *changes: str) -> EmbeddedPeer:
    config = SimConfig(autopilot="px4" if "px4" in kind else "ardupilot")
    peer = EmbeddedPeer(settings.changed(with_camera_kind(config, kind), changes))
    peer.send(command(SET_MODE, to=250))  # nothing is forwarded to a ground station that was never heard
    peer.listen(2.0)
    return peer


def of(heard: list[Heard], name: str, component: int = 100) -> list[Any]:
    return [item.message for item in heard if item.name == name and item.component == component]


def shot(peer: EmbeddedPeer, *, to: int = 100, wait_s: float = 2.0, number: int = 0) -> tuple[int | None, list[Heard]]:
    """The answer to a photo command, and what was heard in the time after it."""
    peer.send(command(SHOOT, 0, 0, 1, number, to=to))
    heard = peer.listen(wait_s)
    return result_of(heard, SHOOT, to), heard


def exposures(peer: EmbeddedPeer) -> list[float]:
    return [event["sim_s"] for event in peer.truth.events if event["event"] == "exposure"]


@pytest.mark.parametrize("kind", CAMERA_KINDS)
def test_every_kind_starts_and_is_a_configuration_like_any_other(kind: str) -> None:
    config = SimConfig(autopilot="px4" if "px4" in kind else "ardupilot")
    changed = with_camera_kind(config, kind)
    assert settings.from_json(settings.to_json(changed)) == changed
    assert (changed == config) is (kind == "mavlink")
    peer_of(kind)


def test_an_unknown_kind_and_a_wrong_autopilot_say_what_there_is() -> None:
    with pytest.raises(UsageError, match="--camera-kind gopro: unknown kind of camera; known are mavlink, servo, late"):
        with_camera_kind(SimConfig(), "gopro")
    with pytest.raises(UsageError, match="px4-trigger: only with --autopilot px4"):
        with_camera_kind(SimConfig(), "px4-trigger")
    with pytest.raises(UsageError, match="deferred: only with --autopilot ardupilot"):
        with_camera_kind(SimConfig(autopilot="px4"), "deferred")


@pytest.mark.parametrize(("kind", "least_s", "most_s"), [("late", 1.2, 1.2), ("late-and-irregular", 0.2, 1.7)])
def test_a_late_shutter_tells_when_it_opened(kind: str, least_s: float, most_s: float) -> None:
    peer, delays = peer_of(kind), []
    for number in range(6):
        asked_s = peer.simulation.timeline.now_s
        answer, heard = shot(peer, wait_s=3.0, number=number)
        assert answer == ACCEPTED
        (report,) = of(heard, "CAMERA_IMAGE_CAPTURED")
        delays.append(report.time_boot_ms / 1000 + 0.25 - asked_s)  # the payload boots 0.25 s after the autopilot
    assert min(delays) == pytest.approx(least_s, abs=0.01) or (min(delays) >= least_s and max(delays) <= most_s)
    assert len(set(delays)) == (6 if most_s > least_s else len(set(delays)))


@pytest.mark.parametrize(
    ("kind", "answer", "told"),
    [("deferred", ACCEPTED, True), ("deferred-untold", ACCEPTED, False), ("deferred-failed", FAILED, False)],
)
def test_an_early_trigger_of_the_autopilot_is_carried_out_later(kind: str, answer: int, told: bool) -> None:
    peer = peer_of(kind)
    peer.send(mavlink.MAVLink_param_request_read_message(1, 1, b"CAM1_INTRVAL_MIN", -1))
    assert [message.param_value for message in of(peer.listen(0.2), "PARAM_VALUE", 1)] == ([2.5] if told else [])
    began_s = peer.simulation.timeline.now_s
    answers = [shot(peer, to=1, wait_s=0.5, number=n)[0] for n in range(3)]
    assert answers == [ACCEPTED, answer, answer]
    heard = peer.listen(4.0)
    assert len(of(heard, "CAMERA_FEEDBACK", 1)) == 1, "one trigger at most is kept"
    assert [t - began_s for t in exposures(peer)] == pytest.approx([0.05, 2.55], abs=0.01)


def test_a_queue_accepts_all_and_exposes_when_it_can() -> None:
    peer = peer_of("queue")
    began_s = peer.simulation.timeline.now_s
    answers = [shot(peer, wait_s=0.2, number=n)[0] for n in range(5)]
    assert answers == [ACCEPTED] * 4 + [REJECTED]
    peer.listen(10.0)
    assert [t - began_s for t in exposures(peer)] == pytest.approx([0.05, 2.55, 5.05, 7.55], abs=0.05)


def test_a_slow_camera_rejects_for_a_while() -> None:
    peer = peer_of("slow", "camera.interval_s=3")
    assert [shot(peer, wait_s=1.4, number=n)[0] for n in range(4)] == [ACCEPTED, REJECTED, REJECTED, ACCEPTED]
    assert len(exposures(peer)) == 2


@pytest.mark.parametrize(("kind", "answer", "then"), [("video-mode", ACCEPTED, 0), ("video-locked", DENIED, 1)])
def test_a_camera_in_video_mode_takes_no_photo_until_it_is_told(kind: str, answer: int, then: int) -> None:
    peer = peer_of(kind)
    assert shot(peer)[0] == DENIED
    peer.send(command(SET_MODE, 0, 0, to=100))
    heard = peer.listen(0.5)
    assert result_of(heard, SET_MODE, 100) == answer
    peer.send(command(REQUEST, 260, to=100))
    assert of(peer.listen(0.5), "CAMERA_SETTINGS")[-1].mode_id == then
    assert shot(peer, number=1)[0] == (ACCEPTED if then == 0 else DENIED)


@pytest.mark.parametrize(("kind", "flags", "takes"), [("streamer", 256, False), ("two-cameras", 2, True)])
def test_another_component_is_the_first_camera(kind: str, flags: int, takes: bool) -> None:
    peer = peer_of(kind)
    beats = {item.component for item in peer.listen(2.5) if item.name == "HEARTBEAT" and item.message.type == 30}
    assert beats == {100, 101}
    for component, expected in ((100, flags), (101, 6)):
        peer.send(command(REQUEST, 259, to=component))
        assert of(peer.listen(0.3), "CAMERA_INFORMATION", component)[0].flags == expected
    assert shot(peer, to=100)[0] == (ACCEPTED if takes else UNSUPPORTED)
    assert not exposures(peer), "it is not the camera of the panorama"
    assert shot(peer, to=101)[0] == ACCEPTED
    assert len(exposures(peer)) == 1


def test_px4_triggers_by_digicam_control_alone() -> None:
    peer = peer_of("px4-trigger")
    for number in (259, 262, 263):
        peer.send(command(REQUEST, number, to=1))
        assert result_of(peer.listen(0.3), REQUEST) == DENIED
    assert shot(peer, to=1)[0] == UNSUPPORTED
    peer.send(command(DIGICAM, 0, 0, 0, 0, 1, to=1))
    heard = peer.listen(1.0)
    assert result_of(heard, DIGICAM) == ACCEPTED
    assert [message.seq for message in of(heard, "CAMERA_TRIGGER", 1)] == [1]
    (report,) = of(heard, "CAMERA_IMAGE_CAPTURED", 1)
    assert (report.image_index, report.capture_result) == (1, -1)
    assert len(exposures(peer)) == 1


def test_every_third_photo_stays_untold() -> None:
    peer = peer_of("silent-third", "camera.interval_s=0.1")
    reports = [of(shot(peer, wait_s=1.0, number=n)[1], "CAMERA_IMAGE_CAPTURED") for n in range(4)]
    assert [len(found) for found in reports] == [1, 1, 0, 1]
    peer.send(command(REQUEST, 263, 3, to=100))
    heard = peer.listen(0.5)
    assert (result_of(heard, REQUEST, 100), of(heard, "CAMERA_IMAGE_CAPTURED")) == (DENIED, [])
    peer.send(command(REQUEST, 262, to=100))
    assert of(peer.listen(0.5), "CAMERA_CAPTURE_STATUS")[0].image_count == 4


def test_a_camera_that_restarts_begins_anew() -> None:
    peer = peer_of("index-reset", "camera.reset_after=2")
    reports = [of(shot(peer, number=n)[1], "CAMERA_IMAGE_CAPTURED")[0] for n in range(3)]
    assert [report.image_index for report in reports] == [1, 2, 1]
    assert reports[2].time_boot_ms < reports[1].time_boot_ms
    files = [event["file"] for event in peer.truth.events if event["event"] == "exposure"]
    assert len(set(files)) == 3


def test_undated_reports_have_no_time() -> None:
    assert of(shot(peer_of("undated"))[1], "CAMERA_IMAGE_CAPTURED")[0].time_boot_ms == 0


def test_numbers_of_a_kind_can_be_changed() -> None:
    config = settings.changed(with_camera_kind(SimConfig(), "late"), ["camera.latency_s=0.7"])
    assert config.camera == replace(SimConfig().camera, latency_s=0.7)
