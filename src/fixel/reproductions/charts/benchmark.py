"""Figure of a benchmark: held-out errors by group, and their distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import save_filled
from fixel.reproductions.charts.replay import SHOWN, WIDE, refuse_file
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MODELS: Final = ("published", "uncalibrated", "calibrated")
COLOURS: Final = {
    "published": palette.PUSHER,
    "uncalibrated": palette.FIXEL,
    "calibrated": palette.BODY,
}
MARKERS: Final = {"published": "s", "uncalibrated": "o", "calibrated": "D"}
# Colour of the calibrated curve of each protocol.
SHADES: Final = (palette.BODY, palette.TOUCHED, palette.CONE, palette.TRAIL, palette.FORCE)
# Share marked by a thin line in the distributions: the median.
HALF: Final = 0.5


class ProtocolPanel(NamedTuple):
    """Errors of one protocol, by group and by model."""

    protocol: str
    groups: Sequence[str]
    mean: Mapping[str, FloatArray]  # model -> (n_group,) mean position errors [mm]
    position: Mapping[str, FloatArray]  # model -> (n,) [mm]
    angle: Mapping[str, FloatArray]  # model -> (n,) [deg]


class BenchmarkPicture(NamedTuple):
    """Panels of a benchmark, one per protocol; groups are drawn for the first one only."""

    panels: Sequence[ProtocolPanel]

    @classmethod
    def of(cls, scored: Sequence[tuple[str, Sequence[Any], Any, Any]]) -> BenchmarkPicture:
        """Build from tuples of protocol, rows, and errors of position and angle by model."""
        panels = []
        for protocol, rows, position, angle in scored:
            fine = [row for row in rows if row["shape"] != "all"]
            mean = {
                model: np.array([row[model]["position_mm"]["mean"] for row in fine], np.float64)
                for model in position
            }
            groups = [f"{row['surface']} {row['shape']}" for row in fine]
            panels.append(ProtocolPanel(protocol, groups, mean, position, angle))
        return cls(panels)


def draw(picture: BenchmarkPicture, file: str | Path) -> None:
    """Draw a benchmark to a file that ends with .png, .svg or .pdf."""
    path = Path(file)
    refuse_file(path)
    save_filled(lambda figure: _fill(figure, picture), path)


def _fill(figure: Figure, picture: BenchmarkPicture) -> None:
    n_group = max((len(panel.groups) for panel in picture.panels), default=1)
    figure.set_size_inches(WIDE, 2.8 + 0.14 * n_group)
    axes = figure.subplot_mosaic([["groups", "position"], ["groups", "angle"]])
    if picture.panels:
        _groups(axes["groups"], picture.panels[0])
    _curves(axes["position"], picture, "position", "position error, held out [mm]")
    _curves(axes["angle"], picture, "angle", "angle error, held out [deg]")
    handles, labels = axes["position"].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, loc="outside lower right", ncols=4)


def _groups(axes: Axes, panel: ProtocolPanel) -> None:
    """Draw mean errors of the groups, each with a line from the worst model to the best."""
    place = np.arange(len(panel.groups))[::-1]
    shown = [model for model in MODELS if model in panel.mean]
    table = np.array([panel.mean[model] for model in shown])
    axes.hlines(place, table.min(axis=0), table.max(axis=0), color=palette.FAINT, linewidth=1.5)
    for model in shown:
        axes.plot(
            panel.mean[model],
            place,
            MARKERS[model],
            color=COLOURS[model],
            markersize=4.0,
            label=model,
        )
    axes.set_yticks(place, list(panel.groups))
    axes.set_xlim(left=0.0)
    axes.set_xlabel(f"mean position error, held out, protocol {panel.protocol} [mm]")
    axes.grid(axis="x", color=palette.FAINT, linewidth=0.4)
    axes.legend(
        frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), handletextpad=0.1
    )
    axes.spines[["top", "right"]].set_visible(False)


def _curves(axes: Axes, picture: BenchmarkPicture, what: str, label: str) -> None:
    """Draw cumulative errors: reference models once, then the calibrated one of every protocol."""
    far = 1.0
    first = True
    for panel, shade in zip(picture.panels, SHADES, strict=False):
        errors: Mapping[str, FloatArray] = getattr(panel, what)
        for model in MODELS if first else ("calibrated",):
            if model not in errors:
                continue
            ordered = np.sort(errors[model][np.isfinite(errors[model])])
            if not len(ordered):
                continue
            own = model == "calibrated"
            axes.step(
                ordered,
                np.arange(1, len(ordered) + 1) / len(ordered),
                where="post",
                linewidth=1.2 if own else 1.0,
                linestyle="-" if own else (0, (4, 1.5)),
                color=shade if own else COLOURS[model],
                label=panel.protocol if own else model,
            )
            far = max(far, float(np.quantile(ordered, SHOWN)))
        first = False
    axes.axhline(HALF, color=palette.FAINT, linewidth=0.8, zorder=0.0)
    axes.set(xlabel=label, ylabel="share of pushes below", xlim=(0.0, far), ylim=(0.0, 1.0))
    axes.grid(color=palette.FAINT, linewidth=0.4)
    axes.spines[["top", "right"]].set_visible(False)
