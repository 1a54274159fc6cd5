"""Chart of an orienting plan: the angles of the part that are possible after each push."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.drawing.chart import plot_axes, sheet
from fixel.drawing.top_view import closed_line
from fixel.drawing.view import unit_for
from fixel.model import placed
from fixel.planning.orienting import OrientingPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLE: Final = "Possible angles after each push, with the rotation before it"
STARTS: Final = 720  # angles of the part at the start


def draw_orienting(plan: OrientingPlan, *, ax: Axes | None = None) -> Any:
    """Draw the part on the fence after each push, once for every angle that is possible."""

    def figure() -> Figure:
        tracks = plan.track(np.linspace(0.0, 2.0 * np.pi, STARTS, endpoint=False))
        size = 2.0 * float(np.hypot(*plan.outline.T).max())
        unit = unit_for(size * plan.pushes)
        own = sheet(min(7.0, 1.2 + 1.5 * plan.pushes), 2.2, TITLE)
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

    return plot_axes(figure, ax)
