"""The examination on rendered missions with random faults, on scenes that were not used to choose thresholds.

`PANOEXEC_CONTENT=300` examines 300 missions (an hour or two on two cores; seed: `PANOEXEC_CONTENT_SEED`).
"""

from __future__ import annotations

import os

import pytest

MISSIONS = int(os.environ.get("PANOEXEC_CONTENT", "0") or 0)


@pytest.mark.skipif(not MISSIONS, reason="PANOEXEC_CONTENT=300 examines 300 missions")
def test_bad_photos_are_found_and_clean_ones_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    from tests.support.content_campaign import run  # noqa: PLC0415

    tally = run(MISSIONS, seed=int(os.environ.get("PANOEXEC_CONTENT_SEED", "1000")))
    with capsys.disabled():
        print("\n" + "\n".join(tally.lines()))
    certain = ("photo-black", "photo-swapped", "photo-stale", "photo-truncated", "photo-damaged", "attitude-lie")
    assert tally.share(*certain) >= 0.99
    assert tally.share("photo-blur", "photo-defocus") >= 0.90
    assert len(tally.alarms) <= max(1, tally.clean / 300)
    assert len(tally.false_ties) <= 0.01 * tally.ties
    assert tally.tied >= 0.98 * tally.pairs
