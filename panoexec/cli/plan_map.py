"""Plots of plans: an equirectangular map of the sphere with outlined image footprints and shaded coverage.

matplotlib is an optional dependency and slow to import; it is imported only when a plot is requested.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from panoexec.angles import FloatArray, elevation_azimuth
from panoexec.cli.output import counted
from panoexec.errors import DependencyError, UsageError, to_install
from panoexec.files import write_atomically_with
from panoexec.planning.coverage_map import box_mask, coverage_count
from panoexec.planning.geometry.footprint import outline
from panoexec.planning.model import AngleBox, Band, Certificate, Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES: Final = (".png", ".svg")

_SIZE_INCHES: Final = (12.8, 7.2)
_MAP_PLACE: Final = (0.055, 0.15, 0.815, 0.815 / 2 * 12.8 / 7.2)
_LINE_CHARACTERS: Final = 130
_SCALE_PLACE: Final = (0.948, 0.25, 0.012, 0.5)

_COUNT_COLOURS: Final = ("#ffffff", "#e3eef8", "#c3dbef", "#9cc4e4", "#73aad6", "#4d8fc6", "#3274b1")
"""Colours for coverage by 0, 1, 2, … images; the last one also stands for all higher counts."""
_GAP, _OUTSIDE, _MASK = "#f4511e", "#8a8f98", "#5c6370"
_INK, _ROW_COLOURS = "#20252d", ("#0b4f8a", "#00796b")
_WEAK_H, _WEAK_V, _BRIDGE, _ROUTE = "#c2185b", "#7b1fa2", "#e65100", "#37474f"


def check_plot_path(path: Path) -> None:
    """Check before any work that a plot can be written to a file name.

    Raises:
        UsageError: the suffix is not .png or .svg.
        DependencyError: matplotlib is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise UsageError(f"{path}: {found}; a plot is written as .png or .svg")
    _matplotlib("figure")


def plot_plan(
    plan: Plan, path: Path, *, show_route: bool = False, title: str | None = None, dots_per_inch: int = 150
) -> None:
    """Plot a plan: footprints, coverage, rows, and the failures of its certificate.

    Args:
        plan: plan to plot.
        path: file to write; the suffix .png or .svg selects the format.
        show_route: whether to draw the shooting order.
        title: heading instead of the default one.
        dots_per_inch: resolution of a PNG of 12.8 x 7.2 inches.

    Raises:
        UsageError: the suffix is not supported, or the file cannot be written.
        DependencyError: matplotlib is not installed.
    """
    check_plot_path(path)
    figure = plan_figure(plan, show_route=show_route, title=title)
    suffix = path.suffix.lower()[1:]
    # no date and fixed ids, so that the same plan gives the same file
    metadata = {"Date": None} if suffix == "svg" else None
    with _matplotlib("").rc_context({"svg.hashsalt": "panoexec", "svg.fonttype": "none"}):
        write_atomically_with(
            path,
            lambda temporary: figure.savefig(temporary, format=suffix, dpi=dots_per_inch, metadata=metadata),
        )


def plan_figure(plan: Plan, *, show_route: bool = False, title: str | None = None) -> Figure:
    """The plot as a matplotlib figure.

    Args:
        plan: plan to plot.
        show_route: whether to draw the shooting order.
        title: heading instead of the default one.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    figure: Figure = _matplotlib("figure").Figure(figsize=_SIZE_INCHES, facecolor="white")
    axes = figure.add_axes(_MAP_PLACE)
    _set_up_axes(axes)
    _shade_coverage(figure, axes, plan)
    _outline_images(axes, plan)
    if show_route:
        _draw_route(axes, plan)
    if plan.certificate is not None:
        _mark_weaknesses(axes, plan, plan.certificate)
    heading, subheading = _headings(plan)
    lines = subheading.count("\n") + 1
    axes.set_title(title or heading, loc="left", fontsize=13, fontweight="bold", color=_INK, pad=8 + 14 * lines)
    axes.text(0, 1.014, subheading, transform=axes.transAxes, fontsize=9.5, color="#4a5160", va="bottom")
    place: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.1)}
    axes.legend(**place, ncols=5, frameon=False, fontsize=9, handlelength=2.2, columnspacing=1.6)
    return figure


def _matplotlib(module: str) -> Any:
    try:
        return importlib.import_module(f"matplotlib.{module}" if module else "matplotlib")
    except ImportError as error:
        raise DependencyError(f"plots need matplotlib: {to_install('report')}") from error


def _set_up_axes(axes: Axes) -> None:
    axes.set_xlim(-180, 180)
    axes.set_ylim(-90, 90)
    axes.set_aspect("equal")
    axes.set_xticks(range(-180, 181, 30), [_degrees(t) for t in range(-180, 181, 30)])
    axes.set_yticks(range(-90, 91, 15), [_degrees(t) for t in range(-90, 91, 15)])
    axes.set_xlabel("azimuth, clockwise from the yaw reference", color=_INK)
    axes.set_ylabel("elevation", color=_INK)
    axes.tick_params(colors="#4a5160", labelsize=9)
    axes.axhline(0, color=_INK, linewidth=0.7, alpha=0.45, zorder=2)
    for spine in axes.spines.values():
        spine.set_color("#b6bcc6")


def _degrees(angle: float, form: str = "g") -> str:
    """An angle with a true minus sign."""
    return f"{angle:{form}}°".replace("-", "−")


def _shade_coverage(figure: Figure, axes: Axes, plan: Plan, width: int = 1440) -> None:
    """Colour the map by number of images, mark gaps in the band, and dim directions outside the band."""
    colors = _matplotlib("colors")
    count = coverage_count(plan.camera, plan.rotations(), width)
    band = box_mask(plan.constraints.band, width)
    for box in plan.constraints.masks:
        band &= ~box_mask(box, width)
    levels = np.minimum(count, len(_COUNT_COLOURS) - 1).astype(int)
    palette = np.array([colors.to_rgb(colour) for colour in _COUNT_COLOURS])
    picture = palette[levels]
    picture[~band] = 0.72 * picture[~band] + 0.28 * np.array(colors.to_rgb("#e9ebee"))
    picture[band & (count == 0)] = colors.to_rgb(_GAP)
    axes.imshow(picture, extent=(-180, 180, -90, 90), interpolation="nearest", zorder=0)
    _outline_box(axes, plan.constraints.band, _OUTSIDE, "requested band")
    for number, mask in enumerate(plan.constraints.masks):
        _outline_box(axes, mask, _MASK, "masked" if number == 0 else None, hatch="////")
    scale = _matplotlib("cm").ScalarMappable(
        norm=colors.BoundaryNorm(np.arange(-0.5, len(_COUNT_COLOURS)), len(_COUNT_COLOURS)),
        cmap=colors.ListedColormap([_GAP, *_COUNT_COLOURS[1:]]),
    )
    bar = figure.colorbar(scale, cax=figure.add_axes(_SCALE_PLACE))
    labels = [str(n) for n in range(len(_COUNT_COLOURS))]
    bar.set_ticks(list(range(len(_COUNT_COLOURS))), labels=["gap", *labels[1:-1], f"≥ {labels[-1]}"])
    bar.set_label("images that see a direction", fontsize=9, color=_INK)
    bar.ax.tick_params(labelsize=8.5, length=0)
    bar.outline.set_edgecolor("#b6bcc6")


def _outline_box(axes: Axes, box: Band | AngleBox, colour: str, label: str | None, hatch: str | None = None) -> None:
    """Outline a box of directions, in two parts if it crosses the border of the map."""
    patches = _matplotlib("patches")
    left = (box.azimuth_min_deg + 180) % 360 - 180
    span = min(360.0, box.azimuth_span_deg)
    if span >= 360:
        left = -180.0
    for start in (left, left - 360):
        axes.add_patch(
            patches.Rectangle(
                (start, box.elevation_min_deg), span, box.elevation_max_deg - box.elevation_min_deg, fill=False,
                edgecolor=colour, linewidth=1.3, linestyle=(0, (6, 3)), hatch=hatch, zorder=3,
                label=label if start == left else None,
            )
        )  # fmt: skip


def on_map(vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """A path of world directions as a polyline on the map, cut where it crosses azimuth ±180°.

    Args:
        vectors: (n, 3), neighbours less than 180° apart in azimuth.

    Returns:
        Azimuths and elevations, degrees; a NaN separates the two points added on the border of the map.
    """
    elevation, azimuth = elevation_azimuth(vectors)
    jump = np.diff(azimuth)
    cuts = np.flatnonzero(np.abs(jump) > 180)
    if not len(cuts):
        return azimuth, elevation
    side = np.sign(azimuth[cuts])
    whole = 360.0 - np.abs(jump[cuts])
    part = np.where(whole > 0, (180.0 - np.abs(azimuth[cuts])) / np.where(whole > 0, whole, 1.0), 0.5)
    level = elevation[cuts] + part * (elevation[cuts + 1] - elevation[cuts])
    at = np.repeat(cuts + 1, 3)
    gap = np.full_like(side, np.nan)
    return (
        np.insert(azimuth, at, np.stack([side * 180, gap, -side * 180], axis=1).ravel()),
        np.insert(elevation, at, np.stack([level, gap, level], axis=1).ravel()),
    )


def _closed_outline(plan: Plan, index: int) -> tuple[FloatArray, FloatArray]:
    points = outline(plan.camera, plan.rotations()[index], points_per_edge=96)
    return on_map(np.concatenate([points, points[:1]]))


def _outline_images(axes: Axes, plan: Plan) -> None:
    rows = plan.rows()
    for number, (pitch, shots) in enumerate(rows):
        colour = _ROW_COLOURS[number % len(_ROW_COLOURS)]
        for shot in shots:
            axes.plot(*_closed_outline(plan, shot.index), color=colour, linewidth=0.85, alpha=0.85, zorder=4)
        axes.plot(
            [s.yaw_deg for s in shots], [s.pitch_deg for s in shots], ".", color=colour,
            markersize=5 if len(plan.shots) < 80 else 3.4, zorder=6, clip_on=False,
        )  # fmt: skip
        axes.plot([-180, 180], [pitch, pitch], color=colour, linewidth=0.6, alpha=0.35, linestyle=":", zorder=3)
        # in dense plans the row spacing is smaller than a line of text
        axes.annotate(
            f"{_degrees(pitch, '+.1f')}  ×{len(shots)}", (180, pitch), xytext=(5, 0), textcoords="offset points",
            va="center", fontsize=8.5 if len(rows) < 14 else 7, color=colour, annotation_clip=False,
        )  # fmt: skip


def _draw_route(axes: Axes, plan: Plan) -> None:
    """Draw the shooting order as straight lines on the map, which are the motions of pitch and yaw axes."""
    yaw = np.array([s.yaw_deg for s in plan.shots])
    pitch = np.array([s.pitch_deg for s in plan.shots])
    style: dict[str, Any] = {"color": _ROUTE, "linewidth": 1.1, "alpha": 0.75, "zorder": 5}
    for i in range(len(yaw) - 1):
        turn = (yaw[i + 1] - yaw[i] + 180) % 360 - 180
        axes.plot([yaw[i], yaw[i] + turn], pitch[i : i + 2], **style, label="shooting order" if i == 0 else None)
        if abs(yaw[i] + turn) > 180:
            axes.plot([yaw[i + 1] - turn, yaw[i + 1]], pitch[i : i + 2], **style)
    for index, marker, label in ((0, "o", "first"), (-1, "s", "last")):
        axes.plot(
            yaw[index], pitch[index], marker, markersize=8, markerfacecolor="white", markeredgecolor=_ROUTE,
            markeredgewidth=1.6, linestyle="none", zorder=8, label=f"{label} image", clip_on=False,
        )  # fmt: skip


def _mark_weaknesses(axes: Axes, plan: Plan, certificate: Certificate) -> None:
    if certificate.weakest_h is not None and certificate.min_overlap_h is not None:
        label = f"least overlap in a row: {certificate.min_overlap_h:.1%}"
        _highlight(axes, plan, certificate.weakest_h, _WEAK_H, label)
    if certificate.weakest_v is not None and certificate.min_overlap_v is not None:
        label = f"least overlap of rows: {certificate.min_overlap_v:.1%}"
        _highlight(axes, plan, (certificate.weakest_v,), _WEAK_V, label)
    for number, (a, b) in enumerate(certificate.bridges):
        ends = np.stack([_boresight(plan, a), _boresight(plan, b)])
        between = ends[0] + np.linspace(0, 1, 64)[:, None] * (ends[1] - ends[0])
        axes.plot(
            *on_map(between), color=_BRIDGE, linewidth=2.4, linestyle="--", zorder=7,
            label="single connecting pair (bridge)" if number == 0 else None,
        )  # fmt: skip
    if certificate.holes:
        count = len(certificate.holes)
        axes.plot(
            [h.azimuth_deg for h in certificate.holes], [h.elevation_deg for h in certificate.holes], "X",
            color=_GAP, markeredgecolor="white", markeredgewidth=0.9, markersize=10, linestyle="none", zorder=9,
            label=f"{count} hole{'s' if count > 1 else ''}, up to {certificate.holes[0].size_deg:.2g}°",
            clip_on=False,
        )  # fmt: skip


def _highlight(axes: Axes, plan: Plan, indices: tuple[int, ...], colour: str, label: str) -> None:
    for number, index in enumerate(indices):
        azimuth, elevation = _closed_outline(plan, index)
        axes.plot(azimuth, elevation, color=colour, linewidth=1.9, zorder=7, label=None if number else label)


def _boresight(plan: Plan, index: int) -> FloatArray:
    return plan.rotations()[index, :, 0]


def _headings(plan: Plan) -> tuple[str, str]:
    camera, constraints, certificate = plan.camera, plan.constraints, plan.certificate
    rows = len(plan.rows())
    heading = f"{camera.name}: {counted(len(plan.shots), 'image')} in {counted(rows, 'row')}"
    if certificate is not None:
        heading += ", certified" if certificate.certified else ", NOT certified"
    band = constraints.band
    parts = [
        f"{camera.hfov_deg:.1f}° x {camera.vfov_deg:.1f}°",
        f"overlap {constraints.overlap_h:.0%} / {constraints.overlap_v:.0%}",
        f"elevation {_degrees(band.elevation_min_deg)} to {_degrees(band.elevation_max_deg)}",
    ]
    if not band.is_full_circle:
        parts.append(f"azimuth {_degrees(band.azimuth_min_deg)} to {_degrees(band.azimuth_max_deg)}")
    parts.append(f"method {plan.method}")
    if certificate is not None and certificate.uncovered_fraction > 0:
        parts.append(f"{certificate.uncovered_fraction:.2%} not proven to be covered")
    tau = constraints.tolerance
    if not tau.is_zero:
        errors = f"±{tau.pitch_deg:g}° pitch, ±{tau.roll_deg:g}° roll, ±{tau.yaw_deg:g}° yaw"
        parts.append(f"pointing within {errors}")
    text = " · ".join(parts)
    if len(text) > _LINE_CHARACTERS and len(parts) > 1:
        text = " · ".join(parts[:-1]) + "\n" + parts[-1]
    return heading, text
