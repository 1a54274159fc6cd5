"""Texts that lie over one another, by Matplotlib's own renderer, and pages of one column."""

from itertools import combinations, pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection


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


def axes_of(figure):
    """Return the axes of a page by their labels."""
    return {axes.get_label(): axes for axes in figure.axes}


def check_page(figure, banner, real):
    """Check that all is inside the view, no axes overlap, and only simulations have a banner."""
    view = axes_of(figure)["view"]
    drawn = [line.get_xydata() for line in view.lines]
    polygons = [c for c in view.collections if isinstance(c, PolyCollection)]
    drawn += [path.vertices for collection in polygons for path in collection.get_paths()]
    points = np.concatenate(drawn)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = np.array([view.get_xlim(), view.get_ylim()]).T
    assert (points >= low).all()
    assert (points <= high).all()
    places = [axes.get_position() for axes in figure.axes]
    assert all(0.0 < place.y0 < place.y1 < 1.0 for place in places)
    assert all(above.y0 > below.y1 for above, below in pairwise(places))
    assert (banner in " ".join(text.get_text() for text in figure.texts)) != real
