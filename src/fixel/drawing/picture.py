"""Figure of one simulation, sized for one column of a paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import atan, degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette
from fixel.drawing.view import (
    LengthUnit,
    Rectangle,
    arrow_length_per_newton,
    carried,
    centre_path,
    contacts_at,
    ever_touched,
    extent,
    frictions,
    ghosts,
    largest_force,
    round_number,
    sentence,
    shapes_of,
    unit_for,
)
from fixel.errors import InvalidInput
from fixel.model import Ellipsoid, Fixel, placed, support_points
from fixel.simulation import Simulation
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PICTURE_ENDINGS = (".pdf", ".png", ".svg")

Style = dict[str, Any]

CROWD = 8  # from this number of bodies on: no ghosts, no names, no support points
RAMP = (0.18, 0.55)  # opacity of the first and last ghost

# Margins and sizes of the figure [inch].
LEFT, RIGHT, BOTTOM, TOP = 0.48, 0.10, 0.40, 0.26
LEGEND_ROW = 0.128
LETTER = 0.045  # mean width of a letter of a fixel's name
TALLEST, LOWEST = 3.6, 1.1


def draw_simulation(simulation: Simulation, target: str | Path | Axes) -> None:
    """Draw the top view of a simulation: start, path, end, and the contact forces at the end.

    Parameters
    ----------
    simulation : Simulation
        Simulation; for a failed one, the figure shows where it stopped.
    target : str, Path or matplotlib Axes
        File to write (`.pdf`, `.svg` or `.png`), or axes to draw into.

    Raises
    ------
    InvalidInput
        The file name has another ending.
    """
    import matplotlib as mpl
    from matplotlib.axes import Axes

    with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
        if isinstance(target, Axes):
            box = extent(simulation)
            handles = _draw(simulation, target, box)
            target.legend(handles=handles, frameon=False)
        else:
            refuse_ending(target, PICTURE_ENDINGS, "picture")
            _figure(simulation).savefig(target)


def refuse_ending(path: str | Path, endings: Sequence[str], what: str) -> None:
    """Raise `InvalidInput` for a file name whose ending is not one of `endings`."""
    if Path(path).suffix.lower() not in endings:
        raise InvalidInput(
            str(path),
            found=f"the ending {Path(path).suffix!r}" if Path(path).suffix else "no ending",
            expected=f"a {what} file: " + ", ".join(endings),
        )


def save_made(make: Callable[[], Figure], path: str | Path) -> None:
    """Create a figure in the house style and save it; reject other endings than of pictures."""
    import matplotlib as mpl

    refuse_ending(path, PICTURE_ENDINGS, "picture")
    with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
        make().savefig(path)


def save_filled(fill: Callable[[Figure], None], path: str | Path) -> None:
    """Save a figure in the house style with constrained layout, whose content `fill` draws."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
        figure = Figure(layout="constrained")
        FigureCanvasAgg(figure)
        fill(figure)
        figure.savefig(Path(path))


def _figure(simulation: Simulation) -> Any:
    """Create a figure of one column, laid out in inches so that nothing overlaps or is cut off."""
    from matplotlib.figure import Figure

    width = palette.COLUMN - LEFT - RIGHT
    box = _with_names(simulation, extent(simulation), width)
    height = width * (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    height = min(TALLEST, max(LOWEST, height))
    figure = Figure()
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    handles = _draw(simulation, axes, box.with_aspect(height / width))
    columns = 3 if max(len(str(h.get_label())) for h in handles) < 17 else 2
    legend = LEGEND_ROW * -(-len(handles) // columns) + 0.04
    total = BOTTOM + legend + height + TOP
    figure.set_size_inches(palette.COLUMN, total)
    axes.set_position(
        (
            LEFT / palette.COLUMN,
            (BOTTOM + legend) / total,
            width / palette.COLUMN,
            height / total,
        )
    )
    figure.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5 * (LEFT + palette.COLUMN - RIGHT) / palette.COLUMN, 0.02 / total),
        ncols=columns,
        frameon=False,
        borderpad=0.0,
        labelspacing=0.3,
        handlelength=1.7,
        columnspacing=1.2,
        handletextpad=0.5,
    )
    return figure


def _draw(simulation: Simulation, axes: Axes, box: Rectangle) -> list[Artist]:
    unit = unit_for(box.size)
    particles = len(simulation.scene.bodies) >= CROWD
    frame_axes(axes, box, unit)
    handles: list[Artist] = []
    handles += _fixels(simulation, axes, unit)
    handles += _pushers(simulation, axes, unit)
    handles += _bodies(simulation, axes, unit, particles)
    handles += _forces(simulation, axes, unit, box, particles)
    handles += _stop(simulation, axes, unit)
    _heading(simulation, axes)
    return handles


def frame_axes(axes: Axes, box: Rectangle, unit: LengthUnit) -> None:
    """Set limits and labels of a top view."""
    axes.set_xlim(box.x[0] * unit.per_metre, box.x[1] * unit.per_metre)
    axes.set_ylim(box.y[0] * unit.per_metre, box.y[1] * unit.per_metre)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"x [{unit.name}]", labelpad=1.5)
    axes.set_ylabel(f"y [{unit.name}]", labelpad=1.5)
    axes.tick_params(pad=1.5)
    axes.locator_params(nbins=6, steps=[1, 2, 5, 10])
    axes.set_axisbelow(True)


def _heading(simulation: Simulation, axes: Axes) -> None:
    colour = palette.INK if simulation.converged else palette.FORCE
    axes.set_title(sentence(simulation), loc="left", color=colour, pad=4.0)


def _outlines(shape: Any, poses: Any, unit: LengthUnit) -> list[FloatArray]:
    return [placed(shape.outline, pose) * unit.per_metre for pose in poses]


def _patches(axes: Axes, outlines: list[FloatArray], **style: Any) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(outlines, **style), autolim=False)


def _patch(**style: Any) -> Artist:
    from matplotlib.patches import Patch

    return Patch(**style)


def _line(**style: Any) -> Artist:
    from matplotlib.lines import Line2D

    return Line2D([], [], **style)


def _fixels(simulation: Simulation, axes: Axes, unit: LengthUnit) -> list[Artist]:
    handles: list[Artist] = []
    touched = ever_touched(simulation)
    fixels = simulation.scene.fixels
    for colour, label, some in (
        (palette.FIXEL, "fixel", [f for f in fixels if f.name not in touched]),
        (palette.TOUCHED, "fixel, touched", [f for f in fixels if f.name in touched]),
    ):
        style: Style = {"facecolor": colour, "edgecolor": palette.INK, "linewidth": 0.5}
        if some:
            outlines = [placed(f.shape.outline, f.pose) * unit.per_metre for f in some]
            _patches(axes, outlines, zorder=3, **style)
            handles.append(_patch(label=label, **style))
    _fixel_names(simulation, axes, unit)
    return handles


def _named_fixels(simulation: Simulation) -> list[tuple[Fixel, FloatArray]]:
    """Fixels to label, with the direction of the label (four sides), away from the bodies."""
    scene = simulation.scene
    if len(scene.bodies) >= CROWD or len(scene.fixels) > 2 * CROWD:
        return []
    ends = np.array([simulation.final[b.name][:2] for b in scene.bodies])
    middle = np.mean(ends, axis=0) if np.isfinite(ends).all() else np.zeros(2)
    sides = []
    for fixel in scene.fixels:
        x, y = fixel.pose[:2] - middle
        upright = abs(y) >= abs(x)
        side = (0.0, 1.0 if y > 0.0 else -1.0) if upright else (1.0 if x > 0.0 else -1.0, 0.0)
        sides.append((fixel, np.array(side)))
    return sides


def _with_names(simulation: Simulation, box: Rectangle, width: float) -> Rectangle:
    """Widen a rectangle for the names of fixels; `width` of the axes [inch]."""
    (left, right), per_inch = box.x, (box.x[1] - box.x[0]) / width
    for fixel, (side, _) in _named_fixels(simulation):
        reach = fixel.shape.radius + (LETTER * len(fixel.name) + 0.06) * per_inch
        if side > 0.0:
            right = max(right, float(fixel.pose[0]) + reach)
        elif side < 0.0:
            left = min(left, float(fixel.pose[0]) - reach)
    return Rectangle((left, right), box.y)


def _fixel_names(simulation: Simulation, axes: Axes, unit: LengthUnit) -> None:
    """Draw the name of each fixel next to it."""
    for fixel, away in _named_fixels(simulation):
        outline = placed(fixel.shape.outline, fixel.pose)
        edge = outline[np.argmax(outline @ away)] * unit.per_metre
        upright = bool(away[0] == 0.0)
        axes.annotate(
            fixel.name,
            edge,
            xytext=(0.0, 3.0 * np.sign(away[1])) if upright else (3.0 * np.sign(away[0]), 0.0),
            textcoords="offset points",
            ha="center" if upright else ("left" if away[0] > 0 else "right"),
            va=("bottom" if away[1] > 0 else "top") if upright else "center",
            fontsize=palette.FONT_SIZE - 1.5,
            color=palette.INK,
            zorder=7,
            clip_on=True,
        )


def _pushers(simulation: Simulation, axes: Axes, unit: LengthUnit) -> list[Artist]:
    pushers = simulation.scene.pushers
    if not pushers:
        return []
    style: Style = {
        "facecolor": palette.PUSHER,
        "edgecolor": palette.INK,
        "linewidth": 0.5,
    }
    hollow: Style = {"facecolor": "none", "edgecolor": palette.PUSHER, "linewidth": 0.8}
    for pusher in pushers:
        poses = simulation.pose[pusher.name]
        first, last = _outlines(pusher.shape, poses[[0, -1]], unit)
        _patches(axes, [first], linestyle=(0, (3, 2)), zorder=2, **hollow)
        _patches(axes, [last], zorder=3, **style)
        start, end = poses[0, :2] * unit.per_metre, poses[-1, :2] * unit.per_metre
        size = float(np.ptp(first, axis=0).max())
        if np.hypot(*(end - start)) > 0.3 * size:
            axes.annotate(
                "",
                (end[0], end[1]),
                (start[0], start[1]),
                arrowprops={
                    "arrowstyle": "-|>,head_length=0.35,head_width=0.18",
                    "color": palette.INK,
                    "linewidth": 0.7,
                    "shrinkA": 0.0,
                    "shrinkB": 0.0,
                },
                zorder=4,
            )
    names = ", ".join(p.name for p in pushers) if len(pushers) <= 2 else "pushers"
    return [_patch(label=names, **style)]


def _bodies(simulation: Simulation, axes: Axes, unit: LengthUnit, particles: bool) -> list[Artist]:
    from matplotlib.collections import LineCollection

    shapes = shapes_of(simulation)
    bodies = simulation.scene.bodies
    starts: list[FloatArray] = []
    ends: list[FloatArray] = []
    for body in bodies:
        poses = simulation.pose[body.name]
        starts += _outlines(shapes[body.name], poses[:1], unit)
        ends += _outlines(shapes[body.name], poses[-1:], unit)
        if not particles:
            _ghosts(axes, _outlines(body.shape, ghosts(poses, body.shape), unit))
    trails = [centre_path(simulation, b.name) * unit.per_metre for b in bodies]
    thin = 0.4 if particles else 0.8
    start: Style = {"facecolor": "none", "edgecolor": palette.BODY, "linewidth": thin}
    end: Style = {
        "facecolor": tint(palette.BODY, 0.30),
        "edgecolor": palette.BODY,
        "linewidth": thin,
    }
    dashes = (0, (3, 2))
    _patches(axes, starts, linestyle=dashes, zorder=1.5, alpha=0.4 if particles else 1.0, **start)
    _patches(axes, ends, zorder=2.5, **end)
    trail: Style = {
        "color": palette.BODY,
        "linewidth": 0.5 if particles else 0.9,
        "linestyle": (0, (1, 1)),
    }
    axes.add_collection(LineCollection(trails, zorder=3.5, **trail), autolim=False)
    who = bodies[0].name if len(bodies) == 1 else "bodies"
    handles = [
        _patch(label=f"{who}, start", linestyle=dashes, **start),
        _patch(label=f"{who}, end", **end),
        _line(label="centre of mass", **trail),
    ]
    if not particles and not any(isinstance(b.support, Ellipsoid) for b in bodies):
        handles += _supports(simulation, axes, unit)
    return handles


def _ghosts(axes: Axes, outlines: list[FloatArray]) -> None:
    strengths = np.linspace(*RAMP, max(len(outlines), 2))
    for outline, strength in zip(outlines, strengths, strict=False):
        style: Style = {"facecolor": "none", "edgecolor": palette.BODY, "linewidth": 0.6}
        _patches(axes, [outline], alpha=float(strength), zorder=1.2, **style)


def _supports(simulation: Simulation, axes: Axes, unit: LengthUnit) -> list[Artist]:
    points = []
    for body in simulation.scene.bodies:
        at, _, _ = support_points(
            body.support, body.shape, body.com, body.mass, simulation.scene.gravity
        )
        if len(at):
            points.append(placed(at + body.com, simulation.final[body.name]))
    if not points:
        return []
    place = np.concatenate(points) * unit.per_metre
    few = len(place) <= 12 * len(points)
    style: Style = {"marker": "o", "linestyle": "none", "color": palette.BODY}
    style |= {"markersize": 2.6 if few else 1.0, "markeredgewidth": 0.0}
    axes.plot(*place.T, zorder=2.9, **style)
    return [_line(label="support points" if few else "support pressure", **style)]


def _forces(
    simulation: Simulation, axes: Axes, unit: LengthUnit, box: Rectangle, particles: bool
) -> list[Artist]:
    end = float(simulation.time[-1])
    rows = contacts_at(simulation, end)
    contacts = carried(simulation, rows, end)
    force = contacts.force
    largest = largest_force(force)
    if not largest > 0.0 or not np.isfinite(largest):
        return []
    points = contacts.point * unit.per_metre
    per_newton = arrow_length_per_newton(largest, box.size) * unit.per_metre
    if particles:
        return _force_chains(axes, points, force, largest)
    handles = _cones(
        axes, frictions(simulation, rows), points, contacts.normal, largest * per_newton
    )
    seen = np.hypot(*force.T) > 0.01 * largest
    _arrows(axes, points[seen], force[seen] * per_newton)
    _scale(axes, per_newton, largest)
    style: Style = {"color": palette.FORCE, "linewidth": 1.2}
    return [*handles, _line(label="contact force", **style)]


def _arrows(axes: Axes, points: FloatArray, lengths: FloatArray) -> None:
    for point, length in zip(points, lengths, strict=True):
        axes.annotate(
            "",
            point + length,
            point,
            arrowprops={
                "arrowstyle": "-|>,head_length=0.4,head_width=0.2",
                "color": palette.FORCE,
                "linewidth": 1.2,
                "shrinkA": 0.0,
                "shrinkB": 0.0,
            },
            zorder=6,
            annotation_clip=False,
        )


def _scale(axes: Axes, per_newton: float, largest: float) -> None:
    """Draw a scale above the axes: an arrow as long as a round force."""
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    newtons = round_number(0.7 * largest)
    right = axes.get_xlim()[1]
    height = 1.0
    above = ScaledTranslation(0.0, 0.1, axes.figure.dpi_scale_trans)
    where = blended_transform_factory(axes.transData, axes.transAxes) + above
    axes.annotate(
        "",
        (right, height),
        (right - newtons * per_newton, height),
        xycoords=where,
        textcoords=where,
        arrowprops={
            "arrowstyle": "-|>,head_length=0.4,head_width=0.2",
            "color": palette.FORCE,
            "linewidth": 1.2,
            "shrinkA": 0.0,
            "shrinkB": 0.0,
        },
        annotation_clip=False,
    )
    axes.annotate(
        force_text(newtons),
        (right - newtons * per_newton, height),
        xycoords=where,
        xytext=(-2.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="center",
        color=palette.FORCE,
        annotation_clip=False,
    )


def force_text(newtons: float) -> str:
    """Format a round force with a suitable SI prefix."""
    for name, scale in (("N", 1.0), ("mN", 1e-3), ("µN", 1e-6), ("nN", 1e-9)):
        if newtons >= scale:
            return f"{newtons / scale:g} {name}"
    return f"{newtons:.0e} N"


def _cones(
    axes: Axes, friction: FloatArray, points: FloatArray, normals: FloatArray, length: float
) -> list[Artist]:
    from matplotlib.patches import Wedge

    style: Style = {"facecolor": palette.CONE, "edgecolor": "none", "alpha": 0.25}
    drawn = False
    for point, normal, mu in zip(points, normals, friction, strict=True):
        if mu > 0.0:
            along = degrees(np.arctan2(normal[1], normal[0]))
            half = degrees(atan(mu))
            wedge = Wedge(tuple(point), 0.6 * length, along - half, along + half, **style)
            wedge.set_zorder(5)
            axes.add_patch(wedge)
            drawn = True
    return [_patch(label="friction cone", **style)] if drawn else []


def _force_chains(
    axes: Axes, points: FloatArray, force: FloatArray, largest: float
) -> list[Artist]:
    """Draw every contact as a stroke along its force; its width grows with the force."""
    from matplotlib.collections import LineCollection

    size = np.hypot(*force.T)
    seen = size > 0.01 * largest
    limits = axes.get_xlim()
    half = 0.012 * (limits[1] - limits[0])
    along = half * force[seen] / size[seen, None]
    strokes = np.stack((points[seen] - along, points[seen] + along), axis=1)
    widths = 0.3 + 2.2 * size[seen] / largest
    lines = LineCollection(list(strokes), linewidths=widths, color=palette.FORCE, zorder=6)
    lines.set_capstyle("round")
    axes.add_collection(lines, autolim=False)
    label = f"contact force, up to {force_text(float(f'{largest:.2g}'))}"
    return [_line(label=label, color=palette.FORCE, linewidth=2.0)]


def _stop(simulation: Simulation, axes: Axes, unit: LengthUnit) -> list[Artist]:
    """Draw crosses at the bodies where a simulation stopped early."""
    if simulation.converged:
        return []
    places = [centre_path(simulation, b.name)[-1] for b in simulation.scene.bodies]
    style: Style = {
        "marker": "X",
        "linestyle": "none",
        "color": palette.FORCE,
        "markersize": 6.0,
    }
    style |= {"markeredgecolor": "white", "markeredgewidth": 0.6}
    axes.plot(*(np.array(places) * unit.per_metre).T, zorder=8, **style)
    return [_line(label="stopped here", **style)]


def tint(colour: str, strength: float) -> tuple[float, float, float]:
    """Mix a colour with white; `strength` is the share of the colour."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1.0 - strength * (1.0 - c) for c in to_rgb(colour))
    return red, green, blue
