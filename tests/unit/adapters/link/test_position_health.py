"""When a position is not to be trusted, by the receiver's report and the estimator's flags."""

from __future__ import annotations

from typing import Any

import pytest

from panoexec.adapters.position_health import PositionHealth, estimator_doubts, receiver_doubts

GOOD = 16 | 1 | 2


def gps(fix_type: int = 3, *, eph: int = 80, h_acc: int | None = 0) -> dict[str, Any]:
    return {"fix_type": fix_type, "eph": eph, "h_acc": h_acc}


@pytest.mark.parametrize(
    ("fields", "doubt"),
    [
        (gps(), ""),
        (gps(6), ""),
        (gps(2), "no 3D fix (fix type 2)"),
        (gps(0, eph=65535), "no 3D fix (fix type 0)"),
        (gps(h_acc=7_400), "accuracy 7.4 m"),
        (gps(h_acc=1_200, eph=900), ""),
        (gps(eph=900), "HDOP 9.0"),
        (gps(eph=65535), ""),
        (gps(h_acc=None, eph=600), "HDOP 6.0"),
        ({"fix_type": 3, "eph": 120}, ""),  # MAVLink 1 has no accuracy
    ],
)
def test_the_receivers_report(fields: dict[str, Any], doubt: str) -> None:
    assert receiver_doubts(fields) == ((doubt,) if doubt else ())


@pytest.mark.parametrize(
    ("message_id", "flags", "doubt"),
    [
        (193, GOOD, ""),
        (230, GOOD, ""),
        (193, 1 | 2, "no absolute position"),
        (193, GOOD | 128, "constant position"),
        (193, GOOD | 32768, "glitch"),
        (230, GOOD | 1024, "glitch"),
        (193, GOOD | 1024, ""),  # not the same bit
    ],
)
def test_the_estimators_flags(message_id: int, flags: int, doubt: str) -> None:
    found = estimator_doubts(flags, message_id=message_id)
    assert (doubt in found[0]) if doubt else not found


def test_a_receiver_that_never_had_a_fix_does_not_count_and_one_that_lost_it_does() -> None:
    health = PositionHealth()
    health.receiver(gps(0))
    assert not health.doubts
    health.receiver(gps(3))
    health.receiver(gps(1))
    assert health.doubts == ("no 3D fix (fix type 1)",)
    health.estimator(GOOD | 128, message_id=193)
    assert len(health.doubts) == 2
    assert health.estimator_ok is False
    health.forget()
    assert not health.doubts
    assert health.estimator_ok is None
