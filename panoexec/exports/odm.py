"""OpenDroneMap: `geo.txt` with the photos' positions, and copies of photos with XMP inside.

OpenDroneMap reads XMP inside a photo only, never a sidecar, and takes positions from `geo.txt` before those in the
photos. Its versions read the angles of `geo.txt` differently (omega, phi, kappa or yaw, pitch, roll), so only positions
are written there; the attitude is in the XMP of embedded copies.
"""

from __future__ import annotations

import math
from pathlib import Path, PurePosixPath

from panoexec.errors import UsageError
from panoexec.exports.model import ExportSet
from panoexec.exports.xmp_files import sidecar_text
from panoexec.files import write_atomically
from panoexec.formats.xmp import with_xmp


def geo_text(exports: ExportSet) -> str:
    """The text of `geo.txt`: WGS 84 longitude, latitude, and altitude where known; "" without any position.

    Names with spaces are left out: the format separates columns by them.
    """
    lines = []
    for shot in exports.shots:
        name = PurePosixPath(shot.name).name
        if not (math.isfinite(shot.latitude_deg) and math.isfinite(shot.longitude_deg)) or len(name.split()) != 1:
            continue
        altitude = f" {shot.altitude_m:.3f}" if math.isfinite(shot.altitude_m) else ""
        lines.append(f"{name} {shot.longitude_deg:.9f} {shot.latitude_deg:.9f}{altitude}")
    return "\n".join(["EPSG:4326", *lines, ""]) if lines else ""


def write_embedded(exports: ExportSet, folder: Path, target: Path) -> tuple[list[Path], dict[str, str]]:
    """Write copies of the photos with attitude and position as XMP inside; the picture data are not touched.

    Args:
        exports: the photos.
        folder: the mission directory.
        target: folder of the copies, made if needed; it must not be the photos' own.

    Returns:
        The copies, and the photos that could not be copied, with the reason.

    Raises:
        UsageError: the target cannot be written, or is the photos' own folder.
    """
    sources = {shot.name: folder / shot.name for shot in exports.shots}
    if target.resolve() in {source.parent.resolve() for source in sources.values()}:
        raise UsageError(f"{target}: is the folder of the photos themselves; copies need another one")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{target}: cannot be made ({error.strerror})") from error
    written, problems = [], {}
    for shot in exports.shots:
        try:
            content = with_xmp(sources[shot.name].read_bytes(), sidecar_text(exports, shot))
        except OSError as error:
            problems[shot.name] = f"cannot be read ({error.strerror})"
            continue
        except ValueError as error:
            problems[shot.name] = str(error)
            continue
        path = target / PurePosixPath(shot.name).name
        write_atomically(path, content)
        written.append(path)
    return written, problems
