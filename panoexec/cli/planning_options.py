"""The options by which `plan`, `verify` and `dry-run` say what panorama is wanted."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

from panoexec.errors import UsageError
from panoexec.inputs.camera_profiles import CameraProfile, load_profile
from panoexec.optics import Camera
from panoexec.planning.make_plan import METHODS, make_plan
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Plan, Timing, Tolerance, Turning
from panoexec.planning.order.shot_order import ORDERS

DEFAULT_CAMERA = "dji-x5s-15mm"
DEFAULT_OVERLAP = 0.15
DEFAULT_ELEVATION_DEG = (-90.0, 30.0)
DEFAULT_TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)

NOSE_TOLERANCE_DEG = 2.0
"""Of yaw, where the vehicle pans: what ArduCopter's SITL holds in 8 m/s of gusty wind (docs/mission.md)."""


def number(text: str) -> float:
    """A finite number.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def positive(text: str) -> float:
    """A finite number above 0.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} must be more than 0")
    return value


def count(text: str) -> int:
    """A whole number of at least 1.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 1 or more")
    return value


def add_camera_arguments(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """`--camera` and what can be changed of it."""
    group = parser.add_argument_group("camera")
    group.add_argument(
        "--camera",
        required=required,
        metavar="NAME|FILE.toml",
        help="camera profile: a name (`panoexec cameras`) or a file",
    )
    group.add_argument("--orientation", choices=("landscape", "portrait"), help="mounting orientation")
    group.add_argument("--focal-length", type=positive, metavar="MM", help="focal length of a zoom lens (mm)")


def add_constraint_arguments(parser: argparse.ArgumentParser, *, of_file: bool = False) -> None:
    """Overlaps, band, tolerances, masks.

    Args:
        parser: gets them as a group.
        of_file: whether what is not given comes from a plan file, and only then from the defaults.
    """
    first = "the file's, else " if of_file else ""
    group = parser.add_argument_group("panorama (angles in degrees: elevation -90 = nadir, azimuth clockwise)")
    group.add_argument(
        "--overlap", type=number, metavar="F", help=f"minimum overlap, fraction of the image ({first}{DEFAULT_OVERLAP})"
    )
    group.add_argument(
        "--overlap-h",
        type=number,
        metavar="F",
        help="horizontal overlap: overlap of neighbouring images in a row (fraction); overrides --overlap",
    )
    group.add_argument(
        "--overlap-v",
        type=number,
        metavar="F",
        help="vertical overlap: overlap of an image with the neighbouring row (fraction); overrides --overlap",
    )
    group.add_argument(
        "--elevation", type=number, nargs=2, metavar=("MIN", "MAX"), help=f"elevation range to cover ({first}-90 30)"
    )
    group.add_argument(
        "--azimuth", type=number, nargs=2, metavar=("MIN", "MAX"), help=f"azimuth range to cover ({first}full circle)"
    )
    for axis in ("pitch", "roll", "yaw"):
        default = getattr(DEFAULT_TOLERANCE, f"{axis}_deg")
        nose = f"; {NOSE_TOLERANCE_DEG:g} with --yaw vehicle" if axis == "yaw" and not of_file else ""
        group.add_argument(
            f"--tolerance-{axis}", type=number, metavar="DEG", help=f"maximum {axis} error ({first}{default:g}{nose})"
        )
    group.add_argument(
        "--guarantee",
        choices=("coverage", "all"),
        help="conditions that hold for all errors within tolerance: coverage only, or also the overlaps",
    )
    group.add_argument(
        "--mask",
        type=number,
        nargs=4,
        action="append",
        metavar=("E_MIN", "E_MAX", "A_MIN", "A_MAX"),
        help="region that needs no coverage, for example the landing gear (repeatable)",
    )


def add_gimbal_arguments(parser: argparse.ArgumentParser) -> None:
    """Range and angular rates of the gimbal."""
    group = parser.add_argument_group("gimbal")
    group.add_argument("--gimbal-pitch", type=number, nargs=2, metavar=("MIN", "MAX"), help="pitch limits (-90 90)")
    group.add_argument(
        "--gimbal-pan", type=number, nargs=2, metavar=("MIN", "MAX"), help="pan limits (continuous rotation)"
    )
    group.add_argument(
        "--yaw",
        choices=("gimbal", "vehicle", "auto"),
        default="gimbal",
        help="axis that pans: gimbal, vehicle (two-axis gimbals), or auto: vehicle beyond the gimbal's range (gimbal)",
    )
    group.add_argument(
        "--gimbal-rate", type=positive, nargs=2, metavar=("PITCH", "YAW"), help="maximum angular rates in °/s (60 90)"
    )


def add_method_arguments(parser: argparse.ArgumentParser) -> None:
    """How the plan is made."""
    group = parser.add_argument_group("method")
    group.add_argument("--method", choices=METHODS, default="certified", help="planning method (certified)")
    group.add_argument("--columns", type=count, metavar="N", help="hdrpano: number of images at the horizon")
    group.add_argument("--rows", type=count, metavar="N", help="hdrpano: number of rows")
    group.add_argument("--order", choices=ORDERS, default="fastest", help="shooting order (fastest)")


def profile_of(args: argparse.Namespace) -> CameraProfile:
    """The camera profile asked for."""
    return load_profile(args.camera, orientation=args.orientation, focal_length_mm=args.focal_length)


def constraints_of(args: argparse.Namespace, base: Constraints | None = None) -> Constraints:
    """The constraints asked for; what is not asked for comes from `base`, else from the defaults."""
    band = base.band if base else Band(elevation_min_deg=DEFAULT_ELEVATION_DEG[0], elevation_max_deg=30.0)
    tolerance = base.tolerance if base else DEFAULT_TOLERANCE
    if base is None and getattr(args, "yaw", "gimbal") == "vehicle":
        tolerance = replace(tolerance, yaw_deg=NOSE_TOLERANCE_DEG)
    overlaps = (base.overlap_h, base.overlap_v) if base else (DEFAULT_OVERLAP, DEFAULT_OVERLAP)
    elevation = args.elevation or (band.elevation_min_deg, band.elevation_max_deg)
    azimuth = args.azimuth or (band.azimuth_min_deg, band.azimuth_max_deg)
    return Constraints(
        overlap_h=_first(args.overlap_h, args.overlap, overlaps[0]),
        overlap_v=_first(args.overlap_v, args.overlap, overlaps[1]),
        band=Band(
            elevation_min_deg=elevation[0],
            elevation_max_deg=elevation[1],
            azimuth_min_deg=azimuth[0],
            azimuth_max_deg=azimuth[1],
        ),
        tolerance=Tolerance(
            pitch_deg=_first(args.tolerance_pitch, tolerance.pitch_deg),
            roll_deg=_first(args.tolerance_roll, tolerance.roll_deg),
            yaw_deg=_first(args.tolerance_yaw, tolerance.yaw_deg),
        ),
        guarantee=args.guarantee or (base.guarantee if base else "coverage"),
        masks=_masks(args) or (base.masks if base else ()),
        gimbal=_gimbal(args) if hasattr(args, "gimbal_pitch") else None,
    )


def timing_of(profile: CameraProfile | None) -> Timing:
    """What a shot costs with this camera; the defaults for one without a profile."""
    if profile is None:
        return Timing()
    return Timing(exposure_s=profile.max_exposure_s, interval_s=profile.min_interval_s)


def plan_for(args: argparse.Namespace, camera: Camera, constraints: Constraints, timing: Timing) -> Plan:
    """The plan by the method asked for, certified (or found wanting), ordered and estimated.

    Raises:
        PlanningError: no plan can satisfy the constraints.
        UsageError: the method needs options that are not given.
    """
    if args.method == "hdrpano" and not (args.columns and args.rows):
        raise UsageError("--method hdrpano needs --columns N and --rows N (the paper has 8 and 4, 21 and 10)")
    return make_plan(
        camera,
        constraints,
        method=args.method,
        timing=timing,
        order=args.order,
        columns=args.columns,
        rows=args.rows,
    )


def _first(*values: float | None) -> float:
    return next(value for value in values if value is not None)


def _masks(args: argparse.Namespace) -> tuple[AngleBox, ...]:
    return tuple(
        AngleBox(elevation_min_deg=e0, elevation_max_deg=e1, azimuth_min_deg=a0, azimuth_max_deg=a1)
        for e0, e1, a0, a1 in args.mask or ()
    )


def _gimbal(args: argparse.Namespace) -> GimbalLimits | None:
    if not (args.gimbal_pitch or args.gimbal_pan or args.gimbal_rate) and args.yaw == "gimbal":
        return None
    default = GimbalLimits()
    pitch = args.gimbal_pitch or (default.pitch_min_deg, default.pitch_max_deg)
    pan = args.gimbal_pan or (default.yaw_min_deg, default.yaw_max_deg)
    if args.yaw == "vehicle":
        pan = (0.0, 0.0)
    rate = args.gimbal_rate or (default.pitch_rate_deg_s, default.yaw_rate_deg_s)
    return GimbalLimits(
        pitch_min_deg=pitch[0],
        pitch_max_deg=pitch[1],
        yaw_min_deg=pan[0],
        yaw_max_deg=pan[1],
        pitch_rate_deg_s=rate[0],
        yaw_rate_deg_s=rate[1],
        yaw_endless=args.gimbal_pan is None and args.yaw != "vehicle",
        turning=None if args.yaw == "gimbal" else Turning(),
    )
