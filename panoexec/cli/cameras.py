"""List the included camera profiles, or show one profile (by name or file) with its field of view.

`--new` writes a profile to be filled in, with every key explained; an existing file stays as it is.

Examples:
  panoexec cameras dji-x5s-15mm
  panoexec cameras --new my-camera.toml
"""

from __future__ import annotations

import argparse
from importlib.resources import files
from pathlib import Path

from panoexec.cli.output import note, print_facts, print_json, print_table
from panoexec.cli.planning_options import lens_in_words
from panoexec.errors import UsageError
from panoexec.files import write_atomically
from panoexec.inputs.camera_profiles import CameraProfile, list_profiles, load_profile
from panoexec.inputs.plan_file import camera_to_data


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("camera", nargs="?", metavar="NAME|FILE.toml", help="camera profile: a name or a file")
    parser.add_argument("--orientation", choices=("landscape", "portrait"), help="mounting orientation")
    parser.add_argument("--focal-length", type=float, metavar="MM", help="focal length of a zoom lens (mm)")
    parser.add_argument("--new", type=Path, metavar="FILE.toml", help="write a commented profile to be filled in")
    parser.add_argument("--json", action="store_true", help="print one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Show one profile or list all."""
    if args.new is not None:
        _write_new(args.new)
        return 0
    if args.camera:
        profile = load_profile(args.camera, orientation=args.orientation, focal_length_mm=args.focal_length)
        if args.json:
            print_json(_document(profile))
        else:
            _show(profile)
        return 0
    profiles = list_profiles()
    if args.json:
        print_json([_document(profile) for profile in profiles])
        return 0
    print_table(
        "camera profiles",
        ("name", "sensor mm", "image px", "focal mm", "35 mm eq.", "FoV °", "interval s"),
        (
            (
                profile.camera.name,
                f"{profile.camera.sensor_width_mm:g} × {profile.camera.sensor_height_mm:g}",
                f"{profile.camera.image_width_px} × {profile.camera.image_height_px}",
                _focal(profile),
                f"{profile.camera.equivalent_focal_length_mm:.0f}",
                f"{profile.camera.hfov_deg:.2f} × {profile.camera.vfov_deg:.2f}",
                f"{profile.min_interval_s:g}",
            )
            for profile in profiles
        ),
        left=("name",),
    )
    return 0


def _write_new(path: Path) -> None:
    if path.suffix != ".toml":
        raise UsageError(f"--new {path}: the file of a profile ends with .toml")
    if path.exists():
        raise UsageError(f"--new {path}: the file exists already; give another name")
    write_atomically(path, (files("panoexec.inputs") / "camera_template.toml").read_bytes())
    note(f"fill in {path}, then show it: panoexec cameras {path}")
    print(path)


def _show(profile: CameraProfile) -> None:
    camera = profile.camera
    width, height = camera.panorama_px()
    print_facts(
        [
            ("name", camera.name),
            ("sensor", f"{camera.sensor_width_mm:g} × {camera.sensor_height_mm:g} mm"),
            ("image", f"{camera.image_width_px} × {camera.image_height_px} px, {profile.orientation}"),
            ("focal length", f"{_focal(profile)} mm ({camera.equivalent_focal_length_mm:.0f} mm equivalent)"),
            ("lens", lens_in_words(camera)),
            ("field of view", f"{camera.hfov_deg:.2f}° × {camera.vfov_deg:.2f}°"),
            ("whole sphere", f"{width} × {height} px"),
            ("interval", f"{profile.min_interval_s:g} s at least between photos"),
            ("exposure", f"{profile.max_exposure_s:g} s at most"),
            ("source", profile.source),
        ]
    )


def _focal(profile: CameraProfile) -> str:
    zoom = profile.zoom_range_mm
    return f"{profile.camera.focal_length_mm:g}" + (f" ({zoom[0]:g}-{zoom[1]:g})" if zoom else "")


def _document(profile: CameraProfile) -> dict[str, object]:
    return camera_to_data(profile.camera) | {
        "orientation": profile.orientation,
        "zoom_range_mm": list(profile.zoom_range_mm) if profile.zoom_range_mm else None,
        "min_interval_s": profile.min_interval_s,
        "max_exposure_s": profile.max_exposure_s,
        "source": profile.source,
    }
