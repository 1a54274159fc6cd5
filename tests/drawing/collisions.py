"""Texts of a figure that lie over one another, by Matplotlib's own renderer."""

from __future__ import annotations

from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg


def collisions(figure):
    """Return pairs of texts: numbers and names of axes, and titles, of all panels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = []
    for axes in figure.axes:
        if not axes.get_visible():
            continue
        texts = [axes.title, axes.xaxis.label, axes.yaxis.label]
        for axis in (axes.xaxis, axes.yaxis):
            # Ticks beyond the limits exist, and are not drawn.
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for minor in (False, True):
                ticks = axis.get_minor_ticks() if minor else axis.get_major_ticks()
                texts += [
                    tick.label1
                    for tick in ticks
                    if tick.label1.get_visible() and low - slack <= tick.get_loc() <= high + slack
                ]
        boxes += [(t.get_text(), t.get_window_extent()) for t in texts if t.get_text().strip()]
    return [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)]
