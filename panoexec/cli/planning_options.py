"""The options by which `plan`, `verify` and `dry-run` say what panorama is wanted."""

from __future__ import annotations

import argparse
from dataclasses import replace

from panoexec.cli.numbers import count, number, positive
from panoexec.errors import UsageError
from panoexec.inputs.camera_profiles import CameraProfile, load_profile
from panoexec.inputs.plan_file import PlanFile
from panoexec.inputs.plan_options import PlanOptions
from panoexec.inputs.plan_spec import PlanSpec
from panoexec.inputs.skyline import skyline_from_text
from panoexec.optics import Camera
from panoexec.planning.make_plan import METHODS
from panoexec.planning.model import AngleBox, Band, Constraints, GimbalLimits, Timing, Tolerance, Turning
from panoexec.planning.order.shot_order import ORDERS
from panoexec.planning.search.budget import DEFAULT_BUDGET_S
from panoexec.planning.skyline import Skyline

DEFAULT_CAMERA = "dji-x5s-15mm"
DEFAULT_OVERLAP = 0.15
DEFAULT_ELEVATION_DEG = (-90.0, 30.0)
DEFAULT_TOLERANCE = Tolerance(pitch_deg=0.1, roll_deg=0.1, yaw_deg=0.7)

NOSE_TOLERANCE_DEG = 2.0
"""Of yaw, where the vehicle pans: what ArduCopter's SITL holds in 8 m/s of gusty wind (docs/mission.md)."""


def add_camera_arguments(parser: argparse.ArgumentParser, *, required: bool, lens: bool = True) -> None:
    """`--camera` and what can be changed of it; `--lens` where the verb plans or proves."""
    group = parser.add_argument_group("camera")
    group.add_argument(
        "--camera",
        required=required,
        metavar="NAME|FILE.toml",
        help="camera profile: a name (`panoexec cameras`) or a file",
    )
    group.add_argument("--orientation", choices=("landscape", "portrait"), help="mounting orientation")
    group.add_argument("--focal-length", type=positive, metavar="MM", help="focal length of a zoom lens (mm)")
    if lens:
        group.add_argument(
            "--lens",
            choices=("calibrated", "nominal"),
            help="lens that is planned and proven for (calibrated, where the profile knows it)",
        )


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
    group.add_argument(
        "--textured-below",
        type=skyline,
        metavar="DEG|FILE",
        help="where the sky begins, which ties no images: an elevation, or a file of azimuths and elevations",
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
    group.add_argument("--method", choices=METHODS, help="planning method (certified)")
    group.add_argument("--columns", type=count, metavar="N", help="hdrpano: number of images at the horizon")
    group.add_argument("--rows", type=count, metavar="N", help="hdrpano: number of rows")
    group.add_argument("--order", choices=ORDERS, help="shooting order (fastest)")
    group.add_argument(
        "--budget",
        type=positive,
        metavar="SECONDS",
        help=f"processor time of the search, which then ends with the best plan so far ({DEFAULT_BUDGET_S:g})",
    )


def add_duration_arguments(parser: argparse.ArgumentParser) -> None:
    """What the estimate of the duration counts besides slews and exposures."""
    group = parser.add_argument_group("duration")
    group.add_argument("--brackets", type=count, metavar="N", help="photos at each pose (1)")
    group.add_argument(
        "--transfer",
        type=positive,
        metavar="S",
        help="time until a photo's file is here and examined, if files arrive in flight (not counted)",
    )
    group.add_argument(
        "--hover-min",
        type=positive,
        metavar="MIN",
        help="hover time of a full battery: states what part of it is needed",
    )


def lens_in_words(camera: Camera) -> str:
    """The lens that a plan is for."""
    if camera.lens_used == "nominal":
        known = ""
        if camera.is_calibrated:
            known = f"; the calibrated one ({camera.with_lens('calibrated').focal_length_used_mm:g} mm) does not count"
        return f"nominal, {camera.focal_length_used_mm:g} mm{known}"
    parts = [f"calibrated, {camera.focal_length_used_mm:g} mm"]
    if camera.focal_length_used_mm != camera.focal_length_mm:
        parts[0] += f" (nominal {camera.focal_length_mm:g} mm)"
    if camera.distortion_used is not None:
        parts.append("distortion")
    if camera.principal_point_px is not None:
        parts.append("principal point {:g}, {:g} px".format(*camera.principal_point_px))
    if camera.fov_margin:
        parts.append(f"{camera.fov_margin:.2%} of the field of view as margin")
    return ", ".join(parts)


def skyline(text: str) -> Skyline:
    """Where the sky begins: an elevation, or a file of pairs.

    Raises:
        argparse.ArgumentTypeError: the elevation is out of range.
        InputFileError: the file cannot be read or is wrong.
    """
    try:
        return skyline_from_text(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text} {error}") from error


def profile_of(args: argparse.Namespace) -> CameraProfile:
    """The camera profile asked for."""
    return load_profile(args.camera, orientation=args.orientation, focal_length_mm=args.focal_length)


def spec_of(args: argparse.Namespace, *, profile: CameraProfile | None, file: PlanFile | None = None) -> PlanSpec:
    """The panorama that the options ask for; what they leave out comes from the plan file, then from the defaults.

    Args:
        args: as parsed.
        profile: the camera that the options name; None, only with a file, for that of the file.
        file: a plan to be judged or flown, instead of one to be computed.

    Raises:
        UsageError: nobody names a camera, or the method needs options that are not given.
    """
    options = _options_of(args)
    if file is None and options.method == "hdrpano" and not (options.columns and options.rows):
        raise UsageError("--method hdrpano needs --columns N and --rows N (the paper has 8 and 4, 21 and 10)")
    named = None if profile is None else profile.camera
    if file is not None:
        camera = file.camera_for(named)
    else:
        assert named is not None
        camera = named
    defaults = PlanSpec(camera=camera, constraints=_default_constraints(args), timing=_timing(args, profile))
    return replace(options, camera=named).over(defaults, file)


def _timing(args: argparse.Namespace, profile: CameraProfile | None) -> Timing:
    """What a shot costs with this camera; the defaults for one without a profile."""
    timing = Timing(brackets=getattr(args, "brackets", None) or 1, transfer_s=getattr(args, "transfer", None) or 0.0)
    if profile is None:
        return timing
    return replace(timing, exposure_s=profile.max_exposure_s, interval_s=profile.min_interval_s)


def _options_of(args: argparse.Namespace) -> PlanOptions:
    """What the options say; a verb without the gimbal's or the method's options says nothing of them."""
    return PlanOptions(
        lens=getattr(args, "lens", None),
        overlap=args.overlap,
        overlap_h=args.overlap_h,
        overlap_v=args.overlap_v,
        elevation_deg=args.elevation,
        azimuth_deg=args.azimuth,
        tolerance_pitch_deg=args.tolerance_pitch,
        tolerance_roll_deg=args.tolerance_roll,
        tolerance_yaw_deg=args.tolerance_yaw,
        guarantee=args.guarantee,
        masks=_masks(args) or None,
        textured_below=args.textured_below,
        gimbal=_gimbal(args) if hasattr(args, "gimbal_pitch") else None,
        method=getattr(args, "method", None),
        order=getattr(args, "order", None),
        columns=getattr(args, "columns", None),
        rows=getattr(args, "rows", None),
        budget_s=getattr(args, "budget", None),
    )


def _default_constraints(args: argparse.Namespace) -> Constraints:
    tolerance = DEFAULT_TOLERANCE
    if getattr(args, "yaw", "gimbal") == "vehicle":
        tolerance = replace(tolerance, yaw_deg=NOSE_TOLERANCE_DEG)
    low, high = DEFAULT_ELEVATION_DEG
    return Constraints(
        overlap_h=DEFAULT_OVERLAP,
        overlap_v=DEFAULT_OVERLAP,
        band=Band(elevation_min_deg=low, elevation_max_deg=high),
        tolerance=tolerance,
    )


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
        turning=None if args.yaw == "gimbal" else getattr(args, "turning", Turning()),
    )
