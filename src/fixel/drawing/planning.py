"""Charts of plans: simulated motions with failures by kind, capture regions of the pushes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, AbstractChart, clean, legend_below, plot_axes, sheet, tint
from fixel.drawing.top_view import add_arrow, closed_line
from fixel.drawing.view import unit_for
from fixel.errors import InvalidInput
from fixel.model import Body, placed
from fixel.model.goals import Beyond, Exit, Inside, PoseRegion, Seated, centroids
from fixel.planning.plan import PushPlan
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTIONS: Final = 200
FAILURE_COLOURS: Final = (palette.FORCE, palette.CONE, palette.INK, palette.FIXEL)
FAILED_OUTLINES: Final = 12
GRID: Final = 15  # offsets along each axis of a capture region
CAPTURE_RUNS: Final = 8  # scenarios for each of them
SPAN: Final = 4.0  # half-width of a capture region, in standard deviations of the belief
MIN_SPAN: Final = 0.03  # least half-width, relative to the part's size (and to 1 rad)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class PathsChart(AbstractChart):
    """Simulated motions of a plan over its scene, failures in colour by kind.

    Parameters
    ----------
    title : str
    plan : PushPlan
    track : (n, n_time, 3) float64
        Poses of the part in n scenarios [m, m, rad].
    outcome : sequence of str
        Kind of failure of each; empty for success.
    """

    title: str
    plan: PushPlan
    track: FloatArray
    outcome: tuple[str, ...]

    @classmethod
    def of(cls, plan: PushPlan, title: str = "", n: int = MOTIONS) -> PathsChart:
        """Simulate n of the plan's scenarios again, for their motions."""
        total = len(plan.runs.margin)
        rows = np.linspace(0, total - 1, min(n, total)).astype(np.int64)
        runs = plan.simulate(n)
        start = plan.first_pose + plan.runs.scenarios.start[rows]
        track = np.concatenate((start[:, None], runs.pose), axis=1)
        return cls(
            title=title or f"Plan with a stated success probability of {plan.success.stated:.3f}",
            plan=plan,
            track=track,
            outcome=tuple(plan.runs.outcome[k] for k in rows),
        )

    def figure(self) -> Figure:
        figure = sheet(0.62 * WIDE, 3.4, self.title)
        axes = figure.subplots()
        scene, body = self.plan.scene, self.plan.scene.bodies[0]
        unit = unit_for(4.0 * float(np.ptp(body.shape.outline, axis=0).max()))
        _fixtures(axes, self.plan, unit)
        kinds = [kind for kind in self.plan.failures if kind in self.outcome]
        for kind in ("", *kinds):
            own = self.track[[outcome == kind for outcome in self.outcome]]
            colour = palette.TRAIL if not kind else FAILURE_COLOURS[kinds.index(kind) % 4]
            share = len(own) / len(self.track)
            label = f"{kind or 'meets the goal'}: {share:.0%}"
            _motions(axes, own, body, unit, colour, label, outlines=bool(kind))
        for k, pose in enumerate([*self.plan.start, self.plan.end]):
            line = closed_line(placed(body.shape.outline, pose), unit)
            last = k == len(self.plan.start)
            style = "-" if last else "--"
            label = "planned end" if last else "planned, before each push"
            axes.plot(*line, style, color=palette.BODY, linewidth=1.3 if last else 0.8, label=label)
        for k, path in enumerate(self.plan.path, 1):
            way = unit.factor * path[:, 1:3]
            axes.plot(*way.T, ".", alpha=0.0)  # so that the limits include the arrow
            furthest = way[np.argmax(np.hypot(*(way - way[0]).T))]
            add_arrow(axes, way[0], furthest, color=palette.PUSHER, linewidth=1.4, zorder=6)
            axes.annotate(str(k), tuple(way[0].tolist()), textcoords="offset points",
                          xytext=(-4, 4), color=palette.INK, weight="bold")  # fmt: skip
            tool = scene.pushers[0].shape
            outline = closed_line(placed(tool.outline, path[0, 1:]), unit)
            axes.fill(*outline, color=tint(palette.PUSHER, 0.45), linewidth=0.0)
        _goal(axes, self.plan, unit)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.05)
        axes.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]")
        axes.spines[["top", "right"]].set_visible(False)
        legend_below(figure, [axes], most=3)
        return figure

    def table(self) -> Table:
        end = self.track[:, -1]
        return Table.from_columns(
            {
                "end_x_m": end[:, 0],
                "end_y_m": end[:, 1],
                "end_angle_rad": end[:, 2],
                "failure": list(self.outcome),
            }
        )


def _fixtures(axes: Axes, plan: PushPlan, unit: Any) -> None:
    moved = np.zeros((len(plan.scene.fixels), 3)) if plan.fixels is None else plan.fixels
    wanted = {x for own in plan.goal.clauses if isinstance(own, Seated) for x in own.fixels}
    for fixel, shift in zip(plan.scene.fixels, moved, strict=True):
        colour = palette.TOUCHED if fixel.name in wanted else palette.FIXEL
        line = closed_line(placed(fixel.shape.outline, fixel.pose + shift), unit)
        axes.fill(*line, color=colour, linewidth=0.0)


def _motions(
    axes: Axes,
    tracks: FloatArray,
    body: Body,
    unit: Any,
    colour: str,
    label: str,
    *,
    outlines: bool,
) -> None:
    for track in tracks:
        way = unit.factor * centroids(body, track)
        axes.plot(*way.T, color=colour, linewidth=0.5, alpha=0.6)
    for track in tracks[:FAILED_OUTLINES] if outlines else []:
        line = closed_line(placed(body.shape.outline, track[-1]), unit)
        axes.plot(*line, color=colour, linewidth=0.4, alpha=0.5)
    axes.plot([], [], color=colour, linewidth=1.4, label=label)


def _goal(axes: Axes, plan: PushPlan, unit: Any) -> None:
    """Draw the regions, lines and poses of a goal."""
    body = plan.scene.bodies[0]
    style: dict[str, Any] = {"color": palette.TOUCHED, "linewidth": 1.2, "label": "goal"}
    for own in plan.goal.clauses:
        if isinstance(own, PoseRegion) and own.position is not None:
            axes.plot(*closed_line(placed(body.shape.outline, own.pose), unit), ":", **style)
            centre = placed(body.shape.centroid, own.pose)
            angle = np.linspace(0.0, 2.0 * math.pi, 65)[:, None]
            ring = centre + own.position * np.hstack((np.cos(angle), np.sin(angle)))
            axes.plot(*(unit.factor * ring.T), **style)
        elif isinstance(own, Inside):
            axes.plot(*closed_line(own.region.vertices, unit), **style)
        elif isinstance(own, Beyond):
            axes.plot(*(unit.factor * own.line.T), "-.", **style)
        elif isinstance(own, Exit):
            line = closed_line(own.region.vertices, unit)
            axes.plot(*line, color=palette.FIXEL, linewidth=0.7, label="region not to leave")


class CaptureRegion(NamedTuple):
    """Success of the rest of a plan from offset poses before one of its pushes."""

    across: FloatArray  # (m,) offsets across the push [m]
    angle: FloatArray  # (m,) offsets of the angle [rad]
    success: FloatArray  # (m, m) rate, angles by offsets across
    before: FloatArray  # (n, 2) offsets across and angles of the scenarios before the push
    after: FloatArray  # (n, 2) the same after it, from the planned pose there


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureChart(AbstractChart):
    """Capture region of each push: from which poses before it the plan still reaches the goal.

    Parameters
    ----------
    title : str
    regions : tuple of CaptureRegion
    """

    title: str
    regions: tuple[CaptureRegion, ...]

    @classmethod
    def of(cls, plan: PushPlan, title: str = "") -> CaptureChart:
        """Simulate the rest of the plan from a grid of poses before each push."""
        if not plan.pushes:
            raise InvalidInput("plan", found="no pushes", expected="a plan with pushes")
        chart = PathsChart.of(plan)
        samples = (chart.track.shape[1] - 1) // len(plan.pushes)
        regions = []
        planned = np.vstack((plan.start, plan.end[None]))
        for k, path in enumerate(plan.path):
            way = path[1, 1:3] - path[0, 1:3]
            aside = np.array([-way[1], way[0]]) / np.hypot(*way)
            clouds = [_aside(chart.track[:, j * samples] - planned[j], aside) for j in (k, k + 1)]
            size = float(np.ptp(plan.scene.bodies[0].shape.outline, axis=0).max())
            span = np.maximum(SPAN * clouds[0].std(axis=0), (MIN_SPAN * size, MIN_SPAN))
            across, angle = (np.linspace(-x, x, GRID) for x in span)
            grid = np.array(np.meshgrid(across, angle)).reshape(2, -1).T
            offsets = np.column_stack((grid[:, :1] * aside, grid[:, 1]))
            rate = plan.capture(k, offsets, runs=CAPTURE_RUNS).reshape(GRID, GRID)
            regions.append(CaptureRegion(across, angle, rate, *clouds))
        return cls(title=title or "Capture regions", regions=tuple(regions))

    def figure(self) -> Figure:
        n = len(self.regions)
        figure = sheet(min(WIDE, 1.4 + 2.6 * n), 2.7, self.title)
        row = figure.subplots(1, n, squeeze=False)[0]
        for k, (axes, own) in enumerate(zip(row, self.regions, strict=True), 1):
            unit = unit_for(20.0 * float(own.across[-1]))
            shown = axes.pcolormesh(
                unit.factor * own.across, np.degrees(own.angle), own.success,
                cmap=_colours(), vmin=0.0, vmax=1.0, shading="nearest", rasterized=True,
            )  # fmt: skip
            for cloud, colour, name in (
                (own.before, palette.INK, "before the push"),
                (own.after, palette.BODY, "after the push"),
            ):
                x, y = unit.factor * cloud[:, 0], np.degrees(cloud[:, 1])
                axes.plot(x, y, ".", color=colour, markersize=1.8, label=f"scenarios {name}")
            axes.set_xlim(-unit.factor * own.across[-1], unit.factor * own.across[-1])
            axes.set_ylim(-math.degrees(own.angle[-1]), math.degrees(own.angle[-1]))
            axes.set_xlabel(f"offset across push {k} [{unit.name}]")
            clean(axes)
            axes.grid(visible=False)
        row[0].set_ylabel("offset of the angle [deg]")
        figure.colorbar(shown, ax=row.tolist(), label="success", shrink=0.9, pad=0.02)
        legend_below(figure, row[:1])
        return figure

    def table(self) -> Table:
        columns: dict[str, list[float]] = {
            "push": [], "across_m": [], "angle_rad": [], "success": [],
        }  # fmt: skip
        for k, own in enumerate(self.regions, 1):
            across, angle = np.meshgrid(own.across, own.angle)
            columns["push"] += [k] * across.size
            columns["across_m"] += across.ravel().tolist()
            columns["angle_rad"] += angle.ravel().tolist()
            columns["success"] += own.success.ravel().tolist()
        return Table.from_columns(columns)


def _colours() -> Any:
    """Return the colours of success rates, light enough for dots over them."""
    from matplotlib.colors import LinearSegmentedColormap

    ends = [tint(palette.FORCE, 0.55), tint(palette.INK, 0.04), tint(palette.TOUCHED, 0.5)]
    return LinearSegmentedColormap.from_list("success", ends)


def _aside(offset: FloatArray, aside: FloatArray) -> FloatArray:
    turn = (offset[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    return np.column_stack((offset[:, :2] @ aside, turn))


def draw_paths(plan: PushPlan, *, n: int = MOTIONS, ax: Axes | None = None) -> Any:
    """Draw simulated motions of a plan, failures in colour by kind."""
    return plot_axes(PathsChart.of(plan, n=n).figure, ax)


def draw_capture_regions(plan: PushPlan, *, ax: Axes | None = None) -> Any:
    """Draw the capture region of each push, with the scenarios before and after it."""
    return plot_axes(CaptureChart.of(plan).figure, ax)
