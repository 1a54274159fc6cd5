"""Charts of a camera's accuracy on the plate, and of the coverage by calibration boards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import WIDE, Chart
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.vision.plane_errors import PlaneErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVELS: Final = 9


def camera_error_chart(errors: PlaneErrors, image_size: tuple[int, int], seen: FloatArray) -> Chart:
    """Draw errors of places on the plate in the camera's view, and the coverage by boards.

    Parameters
    ----------
    errors : PlaneErrors
    image_size : (int, int)
        Width and height of the pictures [px].
    seen : (n_row, n_column) float64
        Number of board corners in each cell of the picture; empty if unknown.
    """

    def fill(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        _draw_errors(figure, left, errors)
        _draw_seen(figure, right, image_size, seen)

    return Chart(
        size=(WIDE, 2.9),
        fill=fill,
        data=Table.from_columns(
            {
                **{name: errors.pixels[..., k].ravel() for k, name in enumerate(("u_px", "v_px"))},
                **{name: errors.places[..., k].ravel() for k, name in enumerate(("x_m", "y_m"))},
                "height_m": np.full(errors.camera.size, errors.height),
                "camera_95_m": errors.camera.ravel(),
                "with_noise_95_m": errors.whole.ravel(),
            }
        ),
    )


def _draw_errors(figure: Figure, axes: Axes, e: PlaneErrors) -> None:
    x, y = 1e3 * e.places[..., 0], 1e3 * e.places[..., 1]
    size = 1e3 * e.whole
    shades = axes.contourf(x, y, size, levels=_levels(size), cmap="Blues")
    edge = np.concatenate([e.places[0], e.places[:, -1], e.places[-1, ::-1], e.places[::-1, 0]])
    axes.plot(*(1e3 * edge).T, color=palette.INK, linewidth=0.6)
    worst = np.unravel_index(int(np.argmax(size)), size.shape)
    axes.plot(x[worst], y[worst], "o", color=palette.FORCE, markersize=4.0, clip_on=False)
    axes.annotate(
        f"{size[worst]:.2g} mm",
        (float(x[worst]), float(y[worst])),
        xytext=(0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())),
        textcoords="data",
        ha="center",
        color=palette.FORCE,
        arrowprops={"arrowstyle": "-", "color": palette.FORCE, "linewidth": 0.5},
    )
    axes.set_aspect("equal")
    axes.set(xlabel="x on the plate [mm]", ylabel="y on the plate [mm]")
    axes.set_title(f"95 % of position errors are below, {1e3 * e.height:g} mm above the plate",
                   loc="left")  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    _bar(figure, shades, axes, "error [mm]")


def _draw_seen(figure: Figure, axes: Axes, image_size: tuple[int, int], seen: FloatArray) -> None:
    width, height = image_size
    axes.set_aspect("equal")
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u [px]",
             ylabel="v [px]")  # fmt: skip
    if not seen.size:
        axes.set_title("positions of the boards: unknown", loc="left")
        return
    shown = np.ma.masked_equal(seen, 0.0)
    cells = axes.imshow(
        shown, extent=(-0.5, width - 0.5, height - 0.5, -0.5), cmap="Greens", vmin=0.0
    )
    axes.set_title("positions of the boards; white: none", loc="left")
    _bar(figure, cells, axes, "corners")


def _levels(values: FloatArray) -> list[float]:
    """Round contour levels that span the values."""
    from matplotlib.ticker import MaxNLocator

    low, high = float(values.min()), float(values.max())
    if not high > low:
        low, high = 0.9 * low, 1.1 * high + 1e-9
    return [float(level) for level in MaxNLocator(LEVELS).tick_values(low, high)]


def _bar(figure: Figure, shades: Any, axes: Axes, label: str) -> None:
    bar = figure.colorbar(shades, ax=axes, location="bottom", shrink=0.8, aspect=30, pad=0.02)
    bar.set_label(label, labelpad=1.5)
    bar.outline.set_linewidth(0.4)
    bar.ax.tick_params(width=0.4, length=2.0, pad=1.5)
