"""What a plan that is as it was asked for may still be too weak in: remarks for people, beside the certificate."""

from __future__ import annotations

from typing import Final

from panoexec.planning.model import Certificate

LEAST_TIE: Final = 0.05
"""Overlaps below this seldom hold enough control points."""


def cautions(certificate: Certificate | None) -> tuple[str, ...]:
    """One remark for each kind of overlap that pointing errors can bring below `LEAST_TIE`."""
    if certificate is None:
        return ()
    found = (
        ("neighbours in a row", certificate.min_overlap_h, certificate.worst_overlap_h),
        ("an image and the adjacent row", certificate.min_overlap_v, certificate.worst_overlap_v),
    )
    return tuple(
        f"{whom} overlap by {100 * planned:.1f} % as planned, but only by {100 * worst:.1f} % with the worst pointing "
        f"errors, too little to tie them for certain: raise the overlap, or ask for the guarantee all"
        for whom, planned, worst in found
        if planned is not None and worst is not None and worst < LEAST_TIE
    )
