"""The result of stitching, and its document `stitch.json`."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from panoexec.stitching.completeness import Completeness, PanoramaHole

FORMAT: Final = "panoexec.stitch/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchResult:
    """The result of stitching.

    Attributes:
        completeness: equation (8) and the holes.
        images: number of stitched photos.
        left_out: unusable photos, with the reason.
        untied: names of photos without control points to the others; they keep their measured angles.
        points: control points used.
        rms_px: their residual, pixels of the photos.
        hfov_deg: field of view as adjusted.
        correction_deg: largest correction of an image's attitude.
        canvas_px: size of the whole sphere.
        seconds: duration of each step, over all runs.
        panorama: the TIFF.
        preview: the JPEG.
        content: what the examination of the photos found (`Examination.to_json`).
    """

    completeness: Completeness
    images: int
    left_out: dict[str, str]
    untied: tuple[str, ...]
    points: int
    rms_px: float
    hfov_deg: float
    correction_deg: float
    canvas_px: tuple[int, int]
    seconds: dict[str, float] = field(default_factory=dict)
    panorama: Path = Path()
    preview: Path = Path()
    content: dict[str, Any] = field(default_factory=dict)

    @property
    def bad(self) -> list[dict[str, Any]]:
        """Photos that do not count: shot, file, code, reason."""
        return list(self.content.get("bad", []))

    def to_json(self) -> dict[str, Any]:
        """A JSON object (`panoexec.stitch/1`)."""
        document = asdict(self)
        rms = self.rms_px if np.isfinite(self.rms_px) else None
        return {
            "format": FORMAT,
            **document,
            "rms_px": rms,
            "panorama": self.panorama.name,
            "preview": self.preview.name,
        }


def result_from_json(document: dict[str, Any], work: Path) -> StitchResult:
    """The result that `StitchResult.to_json` wrote.

    Args:
        document: the JSON object.
        work: its folder.
    """
    verdict = document["completeness"]
    holes = tuple(PanoramaHole(**hole) for hole in verdict["holes"])
    return StitchResult(
        completeness=Completeness(**{**verdict, "holes": holes}),
        images=document["images"],
        left_out=document["left_out"],
        untied=tuple(document["untied"]),
        points=document["points"],
        rms_px=float("nan") if document["rms_px"] is None else document["rms_px"],
        hfov_deg=document["hfov_deg"],
        correction_deg=document["correction_deg"],
        canvas_px=(document["canvas_px"][0], document["canvas_px"][1]),
        seconds=document["seconds"],
        panorama=work / document["panorama"],
        preview=work / document["preview"],
        content=document.get("content", {}),
    )
