"""Plots of the errors of several experiments, and of measured and simulated motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import plot_axes
from fixel.drawing.experiment import comparison_figure
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (palette.FIXEL, palette.BODY, palette.PUSHER, palette.TOUCHED, palette.FORCE)


def plot_errors(comparison: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the share of the experiments whose error is below a value, for each model.

    Parameters
    ----------
    comparison : Comparison
    ax : matplotlib.axes.Axes, optional
    """
    from matplotlib import pyplot

    axes = ax or pyplot.subplots(figsize=(4.9, 3.5), layout="constrained")[1]
    lines = dict.fromkeys((row.model, row.use) for row in comparison.rows)
    models = list(comparison.models)
    for model, use in lines:
        rows = [row for row in comparison.of(model) if row.use == use]
        errors = np.sort([row.error_mm for row in rows if row.error_mm is not None])
        share = 100.0 * np.arange(1, len(errors) + 1) / max(1, len(rows))
        axes.step(
            np.concatenate(([0.0], errors)),
            np.concatenate(([0.0], share)),
            where="post",
            label=f"{model}{f', {use}' if use else ''} ({len(rows)})",
            color=COLOURS[models.index(model) % len(COLOURS)],
            linestyle="--" if use == "fitted" else "-",
        )
    axes.set_xlim(left=0.0)
    axes.set_ylim(0.0, 101.0)
    axes.set_xlabel("error [mm]")
    axes.set_ylabel("experiments below [%]")
    axes.legend(loc="lower right")
    return axes


def plot_motion(
    comparison: Any,
    *,
    ax: Axes | None = None,
    experiment: str | None = None,
    model: str | None = None,
) -> Any:
    """Draw measured and simulated motion of one experiment, and the errors against time.

    Parameters
    ----------
    comparison : Comparison
    ax : None
        The plot has axes of its own.
    experiment : str, optional
        Key of the experiment; by default the first.
    model : str, optional
        Name of the model; by default the last.
    """
    rows = comparison.of(model or comparison.models[-1])
    chosen = [row for row in rows if experiment in (None, row.run.experiment.key)]
    if not chosen:
        raise InvalidInput(
            "experiment" if rows else "model",
            found=repr(experiment if rows else model),
            expected="a compared experiment",
        )
    run = chosen[0].run
    return plot_axes(lambda: comparison_figure(run.experiment, run.simulated, run.contacts), ax)
