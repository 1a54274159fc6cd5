"""Drawings of plans: a panel for each shape and layout, and everything inside it."""

from dataclasses import replace

import numpy as np
from matplotlib.collections import PolyCollection

from fixel.drawing.plan import MAX_GHOSTS, MAX_PANELS, draw_plan, plan_figure
from fixel.sampling import FixelLayout, Grid, Nominal, thesis_plan

PLAN = thesis_plan()
ONE = replace(PLAN, shapes=PLAN.shapes[:1], layouts=PLAN.layouts[:1], schemes=(Nominal(),))


def test_plans_can_be_drawn(tmp_path):
    draw_plan(ONE, tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 5000


def test_every_shape_and_layout_has_its_panel():
    axes = plan_figure(PLAN).axes
    assert [a.get_title(loc="left") for a in axes] == 2 * [layout.title for layout in PLAN.layouts]


def test_everything_is_inside_its_panel():
    for axes in plan_figure(PLAN).axes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        for collection in axes.collections:
            assert isinstance(collection, PolyCollection)
            points = np.concatenate([path.vertices for path in collection.get_paths()])
            assert (points >= (left, low)).all()
            assert (points <= (right, high)).all()


def test_panels_lie_on_the_page_and_apart():
    places = [axes.get_position() for axes in plan_figure(PLAN).axes]
    assert all(0.0 < p.x0 < p.x1 <= 1.0 and 0.0 < p.y0 < p.y1 <= 1.0 for p in places)
    for k, first in enumerate(places):
        for second in places[k + 1 :]:
            apart_x = first.x1 <= second.x0 or second.x1 <= first.x0
            assert apart_x or first.y1 <= second.y0 or second.y1 <= first.y0


def test_large_plans_are_thinned():
    layouts = tuple(FixelLayout(name=f"l{k}", pegs=((0.7, 0.5),)) for k in range(30))
    grid = Grid(x=tuple(np.linspace(0.0, 0.02, 50)), y=tuple(np.linspace(-0.02, 0.02, 50)))
    figure = plan_figure(replace(PLAN, layouts=layouts))
    ghosts = plan_figure(replace(ONE, schemes=(grid,))).axes[0].collections
    assert len(figure.axes) == MAX_PANELS
    assert "and 20 more layouts" in [text.get_text() for text in figure.texts]
    assert max(len(c.get_paths()) for c in ghosts) <= MAX_GHOSTS
