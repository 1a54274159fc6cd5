"""Figure of one simulation, sized for one column of a paper."""

from __future__ import annotations

from math import atan, degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette, top_view, view
from fixel.drawing.chart import Style, plot_axes, save_figure, tint
from fixel.model import Ellipsoid, Fixel, placed, support_points
from fixel.simulation import Simulation
from fixel.typing import FloatArray
from fixel.units import DisplayUnit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MANY: Final = 8  # from this number of bodies on: no ghosts, no names, no support points
ARROW: Final[Style] = {"head": 0.4, "color": palette.FORCE, "linewidth": 1.2}
RAMP: Final = (0.18, 0.55)  # opacity of the first and last ghost


def draw_simulation(simulation: Simulation, target: str | Path | Axes) -> None:
    """Draw the top view of a simulation: start, path, end, and the contact forces at the end.

    The target is a file (`.pdf`, `.svg` or `.png`) or axes. A failed simulation is shown up to
    where it stopped. Another ending raises `InvalidInput`.
    """
    import matplotlib as mpl
    from matplotlib.axes import Axes

    if isinstance(target, Axes):
        with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
            box = view.extent(simulation)
            unit = view.unit_for(box.size)
            top_view.frame_axes(target, box, unit)
            target.legend(handles=_draw(simulation, target, box, unit), frameon=False)
    else:
        save_figure(lambda: _figure(simulation), target)


def plot_simulation(simulation: Simulation, *, ax: Axes | None = None) -> Axes:
    """Draw the top view of a simulation into axes; return them."""
    if ax is not None:
        draw_simulation(simulation, ax)
        return ax
    axes: Axes = plot_axes(lambda: _figure(simulation))
    return axes


def _figure(simulation: Simulation) -> Figure:
    box = _with_names(simulation, view.extent(simulation), top_view.WIDTH)
    unit = view.unit_for(box.size)
    page = top_view.column_page(box, unit=unit)
    return top_view.finish_page(page, _draw(simulation, page.view, box, unit))


def _draw(
    simulation: Simulation, axes: Axes, box: view.Rectangle, unit: DisplayUnit
) -> list[Artist]:
    many = len(simulation.scene.bodies) >= MANY
    fixels, touched = simulation.scene.fixels, view.ever_touched(simulation)
    handles = top_view.fixel_outlines(axes, fixels, touched, unit, zorder=3)
    _fixel_names(simulation, axes, unit)
    handles += _pushers(simulation, axes, unit)
    handles += _bodies(simulation, axes, unit, many)
    handles += _forces(simulation, axes, unit, box, many)
    handles += _stop(simulation, axes, unit)
    if simulation.stopped_at is not None:
        state = f"{simulation.status} at {simulation.stopped_at:.4g} s"
    else:
        state = f"{simulation.status}, {simulation.duration:.4g} s in {simulation.steps} steps"
    colour = palette.INK if simulation.converged else palette.FORCE
    axes.set_title(state, loc="left", color=colour, pad=4.0)
    return handles


def _entry(**style: Any) -> Artist:
    """Line or marker in a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **style)


def _named_fixels(simulation: Simulation) -> list[tuple[Fixel, FloatArray]]:
    """Fixels to label, with the direction of the label (four sides), away from the bodies."""
    scene = simulation.scene
    if len(scene.bodies) >= MANY or len(scene.fixels) > 2 * MANY:
        return []
    ends = np.array([simulation.pose[b.name][-1][:2] for b in scene.bodies])
    middle = np.mean(ends, axis=0) if np.isfinite(ends).all() else np.zeros(2)
    sides = []
    for fixel in scene.fixels:
        x, y = fixel.pose[:2] - middle
        upright = abs(y) >= abs(x)
        side = (0.0, 1.0 if y > 0.0 else -1.0) if upright else (1.0 if x > 0.0 else -1.0, 0.0)
        sides.append((fixel, np.array(side)))
    return sides


def _with_names(simulation: Simulation, box: view.Rectangle, width: float) -> view.Rectangle:
    """Widen a rectangle for the names of fixels; `width` of the axes [inch]."""
    (left, right), per_inch = box.x, (box.x[1] - box.x[0]) / width
    for fixel, (side, _) in _named_fixels(simulation):
        reach = fixel.shape.radius + (top_view.LETTER * len(fixel.name) + 0.06) * per_inch
        if side > 0.0:
            right = max(right, float(fixel.pose[0]) + reach)
        elif side < 0.0:
            left = min(left, float(fixel.pose[0]) - reach)
    return view.Rectangle((left, right), box.y)


def _fixel_names(simulation: Simulation, axes: Axes, unit: DisplayUnit) -> None:
    """Draw the name of each fixel next to it."""
    for fixel, away in _named_fixels(simulation):
        outline = placed(fixel.shape.outline, fixel.pose)
        edge = outline[np.argmax(outline @ away)] * unit.factor
        if away[0] == 0.0:
            side: Style = {"ha": "center", "va": "bottom" if away[1] > 0 else "top"}
        else:
            side = {"ha": "left" if away[0] > 0 else "right", "va": "center"}
        top_view.add_name(
            axes, fixel.name, edge.tolist(), xytext=(3.0 * np.sign(away)).tolist(), **side
        )


def _pushers(simulation: Simulation, axes: Axes, unit: DisplayUnit) -> list[Artist]:
    pushers = simulation.scene.pushers
    names = ", ".join(p.name for p in pushers) if len(pushers) <= 2 else "pushers"
    handles: list[Artist] = []
    for pusher in pushers:
        poses = simulation.pose[pusher.name]
        first, last = (placed(pusher.shape.outline, poses[k]) for k in (0, -1))
        top_view.add_outlines(
            axes,
            [first],
            unit,
            **top_view.hollow(palette.PUSHER, linestyle=top_view.DASHED, zorder=2),
        )
        handles = top_view.add_outlines(
            axes, [last], unit, names, **top_view.solid(palette.PUSHER, zorder=3)
        )
        start, end = poses[[0, -1], :2] * unit.factor
        if np.hypot(*(end - start)) > 0.3 * unit.factor * float(np.ptp(first, axis=0).max()):
            top_view.add_arrow(axes, start, end, color=palette.INK, linewidth=0.7, zorder=4)
    return handles


def _bodies(simulation: Simulation, axes: Axes, unit: DisplayUnit, many: bool) -> list[Artist]:
    from matplotlib.collections import LineCollection

    bodies, blue = simulation.scene.bodies, palette.BODY
    name = bodies[0].name if len(bodies) == 1 else "bodies"
    width, faint = (0.4, {"alpha": 0.4}) if many else (0.8, {})
    handles: list[Artist] = []
    for row, label, style in (
        (0, "start", top_view.hollow(blue, width, linestyle=top_view.DASHED, zorder=1.5, **faint)),
        (-1, "end", top_view.solid(tint(blue, 0.30), blue, width, zorder=2.5)),
    ):
        outlines = [placed(b.shape.outline, simulation.pose[b.name][row]) for b in bodies]
        handles += top_view.add_outlines(axes, outlines, unit, f"{name}, {label}", **style)
    for body in () if many else bodies:
        between = view.ghosts(simulation.pose[body.name], body.shape)
        for pose, strength in zip(between, np.linspace(*RAMP, max(len(between), 2)), strict=False):
            style = top_view.hollow(blue, 0.6, alpha=float(strength), zorder=1.2)
            top_view.add_outlines(axes, [placed(body.shape.outline, pose)], unit, **style)
    trails = [view.centre_path(simulation, b.name) * unit.factor for b in bodies]
    trail: Style = {"color": blue, "linewidth": 0.5 if many else 0.9, "linestyle": top_view.DOTTED}
    axes.add_collection(LineCollection(trails, zorder=3.5, **trail), autolim=False)
    handles.append(_entry(label="centre of mass", **trail))
    if not many and not any(isinstance(b.support, Ellipsoid) for b in bodies):
        handles += _supports(simulation, axes, unit)
    return handles


def _supports(simulation: Simulation, axes: Axes, unit: DisplayUnit) -> list[Artist]:
    points = []
    for body in simulation.scene.bodies:
        at, _, _ = support_points(
            body.support, body.shape, body.com, body.mass, simulation.scene.gravity
        )
        if len(at):
            points.append(placed(at + body.com, simulation.pose[body.name][-1]))
    if not points:
        return []
    place = np.concatenate(points) * unit.factor
    few = len(place) <= 12 * len(points)
    style: Style = {"marker": "o", "linestyle": "none", "color": palette.BODY}
    style |= {"markersize": 2.6 if few else 1.0, "markeredgewidth": 0.0}
    axes.plot(*place.T, zorder=2.9, **style)
    return [_entry(label="support points" if few else "support pressure", **style)]


def _forces(
    simulation: Simulation, axes: Axes, unit: DisplayUnit, box: view.Rectangle, many: bool
) -> list[Artist]:
    end = float(simulation.time[-1])
    rows = view.contacts_at(simulation, end)
    points, normal, force = view.carried(simulation, rows, end)
    largest = view.largest_force(force)
    if not largest > 0.0 or not np.isfinite(largest):
        return []
    points = points * unit.factor
    per_newton = view.arrow_length_per_newton(largest, box.size) * unit.factor
    if many:
        return _force_chains(axes, points, force, largest)
    handles = _cones(axes, view.frictions(simulation, rows), points, normal, largest * per_newton)
    seen = np.hypot(*force.T) > 0.01 * largest
    for point, length in zip(points[seen], force[seen] * per_newton, strict=True):
        top_view.add_arrow(axes, point, point + length, **ARROW, zorder=6, annotation_clip=False)
    _scale(axes, per_newton, largest)
    style: Style = {"color": palette.FORCE, "linewidth": 1.2}
    return [*handles, _entry(label="contact force", **style)]


def _scale(axes: Axes, per_newton: float, largest: float) -> None:
    """Draw a scale above the axes: an arrow as long as a round force."""
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    newtons = view.round_number(0.7 * largest)
    right = axes.get_xlim()[1]
    begin = right - newtons * per_newton
    above = ScaledTranslation(0.0, 0.1, axes.figure.dpi_scale_trans)
    where = blended_transform_factory(axes.transData, axes.transAxes) + above
    place: Style = {"xycoords": where, "annotation_clip": False}
    start, end = np.array([[begin, 1.0], [right, 1.0]])
    top_view.add_arrow(axes, start, end, **ARROW, textcoords=where, **place)
    axes.annotate(
        force_text(newtons),
        (begin, 1.0),
        xytext=(-2.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="center",
        color=palette.FORCE,
        **place,
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
    from matplotlib.patches import Patch, Wedge

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
    return [Patch(label="friction cone", **style)] if drawn else []


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
    return [_entry(label=label, color=palette.FORCE, linewidth=2.0)]


def _stop(simulation: Simulation, axes: Axes, unit: DisplayUnit) -> list[Artist]:
    """Draw crosses at the bodies where a simulation stopped early."""
    if simulation.converged:
        return []
    places = [view.centre_path(simulation, b.name)[-1] for b in simulation.scene.bodies]
    style: Style = {"marker": "X", "linestyle": "none", "color": palette.FORCE, "markersize": 6.0,
                    "markeredgecolor": "white", "markeredgewidth": 0.6}  # fmt: skip
    axes.plot(*(np.array(places) * unit.factor).T, zorder=8, **style)
    return [_entry(label="stopped here", **style)]
