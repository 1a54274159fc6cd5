"""Figures of the assembly: success against clearance, and planned pushes into the slot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, sheet, tint
from fixel.drawing.top_view import closed_line
from fixel.model import placed
from fixel.replay.base import Row, hide_spines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from fixel.planning.plan import PushPlan

COLOURS: Final = (palette.BODY, palette.FORCE)
MM: Final = 1e3
SHOWN_RUNS: Final = 60


def assembly_figure(curve: Sequence[Row], plans: Sequence[tuple[PushPlan, int]]) -> Figure:
    """Draw the success of the last push against clearance, and a plan for each clearance.

    Parameters
    ----------
    curve : sequence of dict
        Rows of the last push, from `last_push_curve`.
    plans : sequence of (PushPlan, int)
        Plans with their clearances [um].
    """
    rows = 1 + len(plans) // 2
    figure = sheet(WIDE, 2.4 * rows)
    left, *others = figure.subplots(rows, 2, squeeze=False).ravel()
    _curves(left, [one for one in curve if one["start"] == "normal"])
    for axes in others[len(plans) :]:
        axes.axis("off")
    for axes, (plan, clearance) in zip(others, plans, strict=False):
        _plan(axes, plan)
        axes.set_title(f"{clearance} µm: stated {plan.success.stated:.2f}", loc="left")
    return figure


def _curves(axes: Axes, rows: Sequence[Row]) -> None:
    probes = [name for name in rows[0] if name.startswith("probe_")]
    for ahead, colour in zip(
        dict.fromkeys(one["mouth_ahead_um"] for one in rows), COLOURS, strict=True
    ):
        own = [one for one in rows if one["mouth_ahead_um"] == ahead]
        for name, dash in zip(probes, ("-", "--", ":"), strict=True):
            where = name.removeprefix("probe_").removesuffix("_um")
            axes.plot(
                [one["clearance_um"] for one in own], [one[name] for one in own], dash,
                color=colour, marker=".", linewidth=1.0, label=f"{ahead} µm ahead, at {where} µm",
            )  # fmt: skip
    axes.set(
        xscale="log", xlabel="clearance [µm]", ylabel="success of the last push", ylim=(0, 1.03)
    )
    clearances = sorted({one["clearance_um"] for one in rows})
    apart = zip(clearances, [*clearances[1:], math.inf], strict=True)
    ticks = [x for x, above in apart if above > 1.25 * x]  # labels of nearer ones would overlap
    axes.set_xticks(ticks, [str(x) for x in ticks])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=5.0, loc="lower right", handlelength=4.0)
    hide_spines(axes)


def _plan(axes: Axes, plan: PushPlan) -> None:
    """Draw walls, planned poses before each push, ways of the tool, and simulated ends."""
    scene, outline = plan.scene, plan.scene.bodies[0].shape.outline
    for fixel in scene.fixels:
        axes.fill(*closed_line(placed(fixel.shape.outline, fixel.pose)), color=palette.FIXEL)
    failed = np.array([bool(why) for why in plan.runs.outcome])
    for bad, colour in ((False, palette.TOUCHED), (True, palette.FORCE)):
        for pose in plan.runs.end[failed == bad][:SHOWN_RUNS]:
            axes.plot(*closed_line(placed(outline, pose)), color=colour, linewidth=0.3, alpha=0.3)
    for k, (pose, path) in enumerate(zip(plan.start, plan.path, strict=True)):
        ring = closed_line(placed(outline, pose))
        axes.fill(*ring, color=tint(palette.BODY, 0.15))
        axes.plot(*ring, color=palette.BODY, linewidth=0.6)
        axes.annotate(
            "", xy=MM * path[1, 1:3], xytext=MM * path[0, 1:3],
            arrowprops={"arrowstyle": "->", "color": palette.PUSHER, "linewidth": 1.0},
        )  # fmt: skip
        axes.update_datalim(MM * path[:2, 1:3])  # an arrow alone does not widen the axes
        axes.text(
            MM * path[0, 1],
            MM * path[0, 2],
            f"{k + 1} ",
            ha="right",
            va="center",
            color=palette.INK,
        )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.margins(0.1)  # room for the numbers of the pushes
    hide_spines(axes)


def grasps_figure(rows: Sequence[Row]) -> Figure:
    """Draw stated and held success of every grasp.

    Parameters
    ----------
    rows : sequence of dict
        Rows of `thesis-grasps`.
    """
    figure = sheet(WIDE, 0.16 * len(rows) + 0.8)
    axes = figure.subplots()
    order = sorted(range(len(rows)), key=lambda k: rows[k]["held"])
    place = np.arange(len(rows))
    for name, colour, marker, label in (
        ("least", palette.PUSHER, "|", "worst 5 % of parameters"),
        ("mean", palette.BODY, "o", "mean over parameters"),
        ("held", palette.FORCE, "D", "held in the simulated laboratory"),
        ("look_held", palette.TOUCHED, "x", "held with a look before the stroke"),
    ):
        axes.plot(
            [rows[k][name] for k in order], place, marker, color=colour, label=label, markersize=4.0
        )
    axes.hlines(place, [rows[k]["least"] for k in order], [rows[k]["mean"] for k in order],
                color=palette.FAINT, zorder=0)  # fmt: skip
    axes.set_yticks(
        place, [f"{rows[k]['shape']}, {rows[k]['layout']}: {rows[k]['mode']}" for k in order]
    )
    axes.set(xlabel="success probability", xlim=(-0.02, 1.02), ylim=(-0.5, len(rows) - 0.5))
    figure.legend(frameon=False, ncols=2, loc="outside lower center")
    hide_spines(axes)
    return figure
