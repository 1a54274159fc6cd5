"""Charts of plans: motions, looks, capture regions, causes of failures, trials, possible angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import chart, palette
from fixel.drawing.chart import Chart, Mark
from fixel.drawing.top_view import add_arrow, closed_line, plain_view
from fixel.drawing.view import unit_for
from fixel.errors import InvalidInput, unknown_name
from fixel.model import Body, placed
from fixel.model.goals import Beyond, Exit, Inside, PoseRegion, Seated, centroids
from fixel.model.trajectory import wrapped
from fixel.planning.causes import Explanation, UnknownEffect
from fixel.planning.looks import Walk
from fixel.planning.orienting import OrientingPlan
from fixel.planning.plan import PushPlan
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import ALPHA, Trials
from fixel.table import Table
from fixel.typing import FloatArray, IntArray
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTIONS: Final = 200
FAILURE_COLOURS: Final = (palette.FORCE, palette.CONE, palette.INK, palette.FIXEL)
FAILED_OUTLINES: Final = 12
# What follows a look: no push, or one that moves the part in one of four directions.
NEXT: Final = ("no push", "towards +x", "towards +y", "towards -x", "towards -y")
NEXT_COLOURS: Final = (
    palette.FIXEL, palette.BODY, palette.PUSHER, palette.TRAIL, palette.CONE,
)  # fmt: skip
GRID: Final = 15  # offsets along each axis of a capture region
CAPTURE_RUNS: Final = 8  # scenarios for each of them
SPAN: Final = 4.0  # half-width of a capture region, in standard deviations of the belief
MIN_SPAN: Final = 0.03  # least half-width, relative to the part's size (and to 1 rad)

MAX_BARS: Final = 12
MAX_PANELS: Final = 6
COLUMNS: Final = 3
STARTS: Final = 720  # angles of the part at the start of an orienting plan


def paths_chart(plan: PushPlan, n: int = MOTIONS) -> Chart:
    """Simulate `n` scenarios of a plan again, at most, and draw their motions, failures by kind."""
    total = len(plan.runs.margin)
    rows = np.linspace(0, total - 1, min(n, total)).astype(np.int64)
    track = _tracks(plan, rows)
    if plan.looks is not None:  # their pushes begin anywhere: only the end is drawn
        track = np.concatenate((track, plan.runs.end[rows, None]), axis=1)
    outcome = [plan.runs.outcome[k] for k in rows]
    return Chart(
        title=f"Plan with a success probability of {plan.success.stated:.4f}",
        size=(0.62 * chart.WIDE, 3.4),
        fill=lambda figure: _draw_paths(figure, plan, track, outcome),
        data=Table.from_columns(
            {
                "end_x_m": track[:, -1, 0],
                "end_y_m": track[:, -1, 1],
                "end_angle_rad": track[:, -1, 2],
                "failure": outcome,
            }
        ),
    )


def _tracks(plan: PushPlan, rows: Any) -> FloatArray:
    """Poses (n, n_time, 3) of the part in some scenarios, with their starts [m, m, rad]."""
    start = plan.first_pose + plan.runs.scenarios.start[rows]
    return np.concatenate((start[:, None], plan.simulate(len(rows)).pose), axis=1)


def _draw_paths(figure: Figure, plan: PushPlan, track: FloatArray, outcome: Sequence[str]) -> None:
    axes = figure.subplots()
    scene, body = plan.scene, plan.scene.bodies[0]
    unit = unit_for(4.0 * float(np.ptp(body.shape.outline, axis=0).max()))
    _fixtures(axes, plan, unit)
    kinds = [kind for kind in plan.failures if kind in outcome]
    for kind in ("", *kinds):
        own = track[[one == kind for one in outcome]]
        colour = palette.TRAIL if not kind else FAILURE_COLOURS[kinds.index(kind) % 4]
        label = f"{kind or 'meets the goal'}: {100 * len(own) / len(track):.3g} %"
        _motions(axes, own, body, unit, colour, label, outlines=bool(kind))
    for k, pose in enumerate([*plan.start, plan.end]):
        last = k == len(plan.start)
        label = "planned end" if last else "planned, before each push"
        axes.plot(*closed_line(placed(body.shape.outline, pose), unit), "-" if last else "--",
                  color=palette.BODY, linewidth=1.3 if last else 0.8, label=label)  # fmt: skip
    for k, path in enumerate(plan.path, 1):
        way = unit.factor * path[:, 1:3]
        axes.plot(*way.T, ".", alpha=0.0)  # so that the limits include the arrow
        furthest = way[np.argmax(np.hypot(*(way - way[0]).T))]
        add_arrow(axes, way[0], furthest, color=palette.PUSHER, linewidth=1.4, zorder=6)
        axes.annotate(str(k), tuple(way[0].tolist()), textcoords="offset points",
                      xytext=(-4, 4), color=palette.INK, weight="bold")  # fmt: skip
        outline = closed_line(placed(scene.pushers[0].shape.outline, path[0, 1:]), unit)
        axes.fill(*outline, color=chart.tint(palette.PUSHER, 0.45), linewidth=0.0)
    _goal(axes, plan, unit)
    plain_view(axes, unit)
    chart.legend_below(figure, [axes], most=3)


def _fixtures(axes: Axes, plan: PushPlan, unit: Any) -> None:
    moved = np.zeros((len(plan.scene.fixels), 3)) if plan.fixels is None else plan.fixels
    wanted = {x for own in plan.goal.clauses if isinstance(own, Seated) for x in own.fixels}
    for fixel, shift in zip(plan.scene.fixels, moved, strict=True):
        colour = palette.TOUCHED if fixel.name in wanted else palette.FIXEL
        outline = closed_line(placed(fixel.shape.outline, fixel.pose + shift), unit)
        axes.fill(*outline, color=colour, linewidth=0.0)
    for k, other in enumerate(plan.scene.bodies[1:]):
        outline = closed_line(placed(other.shape.outline, other.pose), unit)
        axes.fill(*outline, facecolor="none", edgecolor=palette.BODY, linewidth=0.8,
                  label="_" * (k > 0) + "other part, at the start")  # fmt: skip
    for k, region in enumerate(plan.choose.obstacles):
        axes.fill(*closed_line(region.outline, unit), facecolor="none", edgecolor=palette.FIXEL,
                  hatch="////", linewidth=0.7, label="_" * (k > 0) + "obstacle")  # fmt: skip


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
        outline = closed_line(placed(body.shape.outline, track[-1]), unit)
        axes.plot(*outline, color=colour, linewidth=0.4, alpha=0.5)
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
            outline = closed_line(own.region.vertices, unit)
            axes.plot(*outline, color=palette.FIXEL, linewidth=0.7, label="region not to leave")


def looks_chart(plan: PushPlan) -> Chart:
    """Draw simulated poses at the first look of a plan, by the direction of the next push.

    A plan without looks raises `InvalidInput`.
    """
    if plan.looks is None:
        raise InvalidInput("plan", found="no looks", expected="a plan with looks")
    walk = plan.looks.walk
    moved = np.nanmean(plan.looks.table.moved[walk.row].astype(np.float64), axis=1)
    direction = np.arctan2(moved[:, 1], moved[:, 0]) + walk.seen[:, 2]
    sector = 1 + np.round(direction / (0.5 * math.pi)).astype(np.int64) % 4
    group = np.where(walk.row < 0, 0, sector)
    return Chart(
        title="Pushes that follow the first look",
        size=(chart.WIDE, 3.0),
        fill=lambda figure: _draw_looks(figure, plan, walk, group),
        data=Table.from_columns(
            {
                "seen_x_m": walk.seen[:, 0],
                "seen_y_m": walk.seen[:, 1],
                "seen_angle_rad": walk.seen[:, 2],
                "next": [NEXT[k] for k in group],
                "probability": walk.probability,
            }
        ),
    )


def _draw_looks(figure: Figure, plan: PushPlan, walk: Walk, group: IntArray) -> None:
    plane, angles = figure.subplots(1, 2)
    body = plan.scene.bodies[0]
    goals = [own for own in plan.goal.clauses if isinstance(own, PoseRegion)]
    place = centroids(body, np.vstack((walk.seen, plan.end, *(own.pose for own in goals))))
    unit = unit_for(4.0 * float(np.ptp(place, axis=0).max()))
    turn = np.degrees(wrapped(walk.seen[:, 2] - plan.end[2]))
    for k in np.unique(group):
        own = group == k
        label = f"{NEXT[k]}: {100 * own.mean():.3g} %, success {walk.probability[own].mean():.2f}"
        style: dict[str, Any] = {"color": NEXT_COLOURS[k], "markersize": 3.0, "alpha": 0.7}
        plane.plot(*(unit.factor * place[: len(own)][own].T), ".", label=label, **style)
        angles.plot(turn[own], walk.probability[own], ".", **style)
    _goal(plane, plan, unit)
    x, y = unit.factor * place[len(walk.seen)]
    plane.plot(x, y, "+", color=palette.INK, markersize=8.0, label="planned end")
    plain_view(plane, unit, " of the centroid")
    # A square about the dots and the goal's position, since outlines would make both small.
    around = [place, *(placed(body.shape.centroid, own.pose) + r * own.position
                       for own in goals if own.position for r in (-1.0, 1.0))]  # fmt: skip
    box = np.vstack(around)
    middle = 0.5 * (box.min(axis=0) + box.max(axis=0))
    half = 1.1 * unit.factor * float(np.abs(box - middle).max())
    x, y = unit.factor * middle
    plane.set_aspect("equal", adjustable="box")
    plane.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    angles.set(xlabel="angle from the planned end [deg]", ylabel="success without another look")
    angles.set(ylim=(-0.03, 1.03))
    chart.clean(angles)
    chart.legend_below(figure, [plane], most=3)


class CaptureRegion(NamedTuple):
    """Success of the rest of a plan from offset poses before one of its pushes."""

    across: FloatArray  # (m,) offsets across the push [m]
    angle: FloatArray  # (m,) offsets of the angle [rad]
    success: FloatArray  # (m, m) rate, angles by offsets across
    before: FloatArray  # (n, 2) offsets across and angles of the scenarios before the push
    after: FloatArray  # (n, 2) the same after it, from the planned pose there


def capture_chart(plan: PushPlan) -> Chart:
    """Simulate the rest of a plan from a grid of poses before each push: does it reach the goal?

    A plan without pushes raises `InvalidInput`.
    """
    if not plan.pushes:
        raise InvalidInput("plan", found="no pushes", expected="a plan with pushes")
    regions = _capture_regions(plan)
    columns: dict[str, list[float]] = {"push": [], "across_m": [], "angle_rad": [], "success": []}
    for k, own in enumerate(regions, 1):
        across, angle = np.meshgrid(own.across, own.angle)
        columns["push"] += [k] * across.size
        columns["across_m"] += across.ravel().tolist()
        columns["angle_rad"] += angle.ravel().tolist()
        columns["success"] += own.success.ravel().tolist()
    return Chart(
        title="Capture regions",
        size=(min(chart.WIDE, 1.4 + 2.6 * len(regions)), 2.7),
        fill=lambda figure: _draw_regions(figure, regions),
        data=Table.from_columns(columns),
    )


def _capture_regions(plan: PushPlan) -> list[CaptureRegion]:
    total = len(plan.runs.margin)
    track = _tracks(plan, np.linspace(0, total - 1, min(MOTIONS, total)).astype(np.int64))
    samples = (track.shape[1] - 1) // len(plan.pushes)
    size = float(np.ptp(plan.scene.bodies[0].shape.outline, axis=0).max())
    planned = np.vstack((plan.start, plan.end[None]))
    regions = []
    for k, path in enumerate(plan.path):
        way = path[1, 1:3] - path[0, 1:3]
        aside = np.array([-way[1], way[0]]) / np.hypot(*way)
        apart = [track[:, j * samples] - planned[j] for j in (k, k + 1)]
        clouds = [np.column_stack((own[:, :2] @ aside, wrapped(own[:, 2]))) for own in apart]
        ends = np.maximum(SPAN * clouds[0].std(axis=0), (MIN_SPAN * size, MIN_SPAN))
        across, angle = (np.linspace(-x, x, GRID) for x in ends)
        grid = np.array(np.meshgrid(across, angle)).reshape(2, -1).T
        offsets = np.column_stack((grid[:, :1] * aside, grid[:, 1]))
        rate = plan.capture(k, offsets, runs=CAPTURE_RUNS).reshape(GRID, GRID)
        regions.append(CaptureRegion(across, angle, rate, *clouds))
    return regions


def _draw_regions(figure: Figure, regions: Sequence[CaptureRegion]) -> None:
    row = figure.subplots(1, len(regions), squeeze=False)[0]
    for k, (axes, own) in enumerate(zip(row, regions, strict=True), 1):
        unit = unit_for(20.0 * float(own.across[-1]))
        across, angle = unit.factor * own.across, np.degrees(own.angle)
        shown = axes.pcolormesh(across, angle, own.success, cmap=_colours(), vmin=0.0, vmax=1.0,
                                shading="nearest", rasterized=True)  # fmt: skip
        for cloud, colour, name in (
            (own.before, palette.INK, "before the push"),
            (own.after, palette.BODY, "after the push"),
        ):
            x, y = unit.factor * cloud[:, 0], np.degrees(cloud[:, 1])
            axes.plot(x, y, ".", color=colour, markersize=1.8, label=f"scenarios {name}")
        axes.set(xlim=(-across[-1], across[-1]), ylim=(-angle[-1], angle[-1]))
        axes.set_xlabel(f"offset across push {k} [{unit.name}]")
        chart.clean(axes)
        axes.grid(visible=False)
    row[0].set_ylabel("offset of the angle [deg]")
    figure.colorbar(shown, ax=row.tolist(), label="success", shrink=0.9, pad=0.02)
    chart.legend_below(figure, row[:1])


def _colours() -> Any:
    """Return the colours of success rates, light enough for dots over them."""
    from matplotlib.colors import LinearSegmentedColormap

    ends = [
        chart.tint(palette.FORCE, 0.55),
        chart.tint(palette.INK, 0.04),
        chart.tint(palette.TOUCHED, 0.5),
    ]
    return LinearSegmentedColormap.from_list("success", ends)


def causes_chart(explanation: Explanation) -> Chart:
    """Draw the share of failures that each unknown explains, and the worth of measuring it."""
    effects = explanation.effects[:MAX_BARS]
    at = np.arange(len(effects))
    worth = np.array([one.worth for one in effects])
    error = np.array([one.worth_error if one.worth > 0.0 else 0.0 for one in effects])
    shares = chart.panel(
        chart.bars(at, [100.0 * one.share for one in effects], 0.6, color=palette.BODY),
        rows=[chart.shorten(one.name, 24) for one in effects],
        xlabel="explains of the failures [%]",
        xlim=(0.0, 100.0),
    )
    gains = chart.panel(
        chart.bars(at, worth, 0.6, xerr=error, color=palette.TOUCHED, error_kw=chart.WHISKER),
        xlabel="success gained by measuring it",
        xlim=(0.0, 1.05 * max([0.01, *(worth + error).tolist()])),
    )
    return Chart(
        title=f"Success in {100.0 * explanation.success:.1f} % of {explanation.n} scenarios",
        size=(chart.WIDE, 0.9 + 0.24 * max(2, len(effects))),
        fill=chart.panels([[shares, gains]], sharey=True),
        data=explanation._data(),
    )


def success_curves_chart(explanation: Explanation, *, unknown: str | None = None) -> Chart:
    """Draw success against one unknown, by name, or against those that explain most.

    An unknown that does not exist raises `InvalidInput`.
    """
    effects = explanation.effects[:MAX_PANELS]
    if unknown is not None or not effects:
        effects = tuple(own for own in explanation.effects if own.name == unknown)
    if not effects:
        raise unknown_name("unknown", unknown, [own.name for own in explanation.effects])
    every = [_success_curve(own, explanation.success, k) for k, own in enumerate(effects)]
    rows = chart.in_rows(every, COLUMNS)
    return Chart(
        size=(chart.WIDE if len(every) > 1 else palette.COLUMN, 1.6 * len(rows) + 0.3),
        fill=chart.panels(rows, sharey=True),
        data=Table(
            ("unknown", "value", "success", "low", "high", "scenarios"),
            [
                (own.name, value, *one)
                for own in effects
                for value, one in zip(own.value, own.success, strict=True)
            ],
        ),
    )


def _success_curve(own: UnknownEffect, mean: float, k: int) -> Mark:
    unit = displayed(own.unit)
    rate, low, high = np.array([(one.value, one.low, one.high) for one in own.success]).T

    def region(axes: Axes) -> None:
        if own.region is None:
            return
        ends = axes.get_xlim()
        for limit, end in zip((own.region.below, own.region.above), ends, strict=True):
            if limit is not None:
                axes.axvspan(end, unit.factor * limit, color=palette.FORCE, alpha=0.12,
                             linewidth=0.0, label="fails mostly here")  # fmt: skip
        axes.set_xlim(*ends)

    return chart.panel(
        chart.whiskers(unit.factor * own.value, rate, yerr=[rate - low, high - rate], fmt="o-",
                       color=palette.BODY, markersize=2.5, linewidth=1.0, elinewidth=0.7,
                       label="with 95 % interval"),
        chart.hline(mean, color=palette.INK, linewidth=0.8, linestyle="--",
                    label="in all scenarios"),
        region,
        xlabel=unit.on(chart.shorten(own.name, 28)),
        ylabel="" if k % COLUMNS else "success",
        ylim=(-0.03, 1.03),
    )  # fmt: skip


def success_chart(own: SuccessProbability) -> Chart:
    """Draw the success rates of the parameter draws in order, their mean, and their range."""
    rates = np.sort(own.rates)
    share = 100.0 * np.arange(1, len(rates) + 1) / len(rates)
    draws = chart.panel(
        chart.steps(share, rates, where="mid", color=palette.BODY, linewidth=1.2,
                    label=f"parameter draws, {own.n_runs} runs each"),
        chart.hline(own.mean, color=palette.INK, linewidth=0.8, linestyle="--", label="mean"),
        lambda axes: axes.axhspan(own.low, own.high, color=palette.INK, alpha=0.1, linewidth=0.0),
        *(
            chart.hline(end, color=palette.FORCE, linewidth=1.0, label=label)
            for end, label in ((own.worst, "range of 90 % of the draws"), (own.best, None))
            if end is not None
        ),
        xlabel="share of the parameter draws [%]",
        ylabel="success rate",
        xlim=(0.0, 100.0),
        ylim=(min(0.9, rates[0], own.mean) - 0.03, 1.02),
    )  # fmt: skip
    return Chart(size=(palette.COLUMN, 2.3), fill=chart.panels([[draws]]), data=own._data())


def trials_chart(own: Trials) -> Chart:
    """Draw the evidence against the stated success probability after each trial."""
    evidence = np.concatenate([[1.0], own.evidence])
    met = np.array([trial.met for trial in own.trials], dtype=bool)
    dots = [
        chart.line(rows, evidence[rows], "o", color=colour, markersize=3.0, label=label)
        for rows, colour, label in (
            (np.flatnonzero(met) + 1, palette.TOUCHED, "goal met"),
            (np.flatnonzero(~met) + 1, palette.FORCE, "failure"),
        )
    ]
    trials = chart.panel(
        chart.line(evidence, color=palette.INK, linewidth=0.8),
        *dots,
        chart.hline(
            1.0 / ALPHA, color=palette.FORCE, linewidth=0.8, linestyle="--", label="refuted"
        ),
        log={"y": np.append(np.maximum(evidence, 1e-3), 1.0 / ALPHA)},
        whole="x",
        xlabel="trial",
        ylabel="evidence against (e-value)",
    )
    return Chart(
        title=f"{own.successes} of {own.n} trials met the goal, stated {own.stated:.2f}",
        size=(palette.COLUMN, 2.1),
        fill=chart.panels([[trials]]),
        data=own._data(),
    )


def orienting_figure(plan: OrientingPlan) -> Figure:
    """Draw the part on the fence after each push, once for every angle that is possible."""
    tracks = plan.track(np.linspace(0.0, 2.0 * np.pi, STARTS, endpoint=False))
    size = 2.0 * float(np.hypot(*plan.outline.T).max())
    unit = unit_for(size * plan.pushes)
    title = "Possible angles after each push, with the rotation before it"
    own = chart.sheet(min(7.0, 1.2 + 1.5 * plan.pushes), 2.2, title)
    axes = own.subplots()
    for k, angles in enumerate(tracks):
        place = 1.4 * size * k
        fence = unit.factor * np.array([[place, -0.6 * size], [place, 0.6 * size]])
        axes.plot(*fence.T, color=palette.PUSHER, linewidth=2.5, solid_capstyle="butt")
        for angle in np.unique(angles):
            outline = placed(plan.outline, (0.0, 0.0, angle))
            outline += (place - outline[:, 0].min(), 0.0)
            axes.plot(*closed_line(outline, unit), color=palette.BODY, linewidth=0.9)
        turn = f"\n{np.degrees(plan.rotations[k - 1]):.1f}\u00b0" if k else ""
        axes.annotate(f"push {k + 1}{turn}", tuple(fence[1].tolist()), (0, 4),
                      textcoords="offset points", color=palette.INK)  # fmt: skip
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_xlabel("direction of each push")
    axes.set_ylabel(f"along the fence [{unit.name}]")
    axes.spines[["top", "right"]].set_visible(False)
    return own
