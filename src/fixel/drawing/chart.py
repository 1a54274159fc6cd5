"""Charts of panels and marks with their data as tables, and helpers for drawing them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from inspect import signature
from io import BytesIO
from itertools import chain, zip_longest
from operator import methodcaller
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fixel.drawing import palette
from fixel.errors import InvalidInput
from fixel.io.atomic import refuse_ending, refuse_unwritable, write_whole
from fixel.table import Table
from fixel.typing import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Style = dict[str, Any]

DASHED: Final = (0, (4, 2))
WHISKER: Final[Style] = {"linewidth": 0.8, "ecolor": palette.INK}
WIDE: Final = 7.16  # [inch], two columns of text
HEAD: Final = 0.22  # [inch]
SCREEN_DPI: Final = 150.0
BANNER: Final = 0.20  # height of a banner [inch]
PICTURE_ENDINGS: Final = (".pdf", ".png", ".svg")


Mark = Callable[["Axes"], object]  # draws in axes
Fill = Callable[["Figure"], object]  # draws panels in a figure

line = partial(methodcaller, "plot")
steps = partial(methodcaller, "step")
band = partial(methodcaller, "fill_between")
bars = partial(methodcaller, "barh")
histogram = partial(methodcaller, "hist")
whiskers = partial(methodcaller, "errorbar")
hline = partial(methodcaller, "axhline")
vline = partial(methodcaller, "axvline")
vspan = partial(methodcaller, "axvspan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Figure with its data as a table."""

    size: tuple[float, float]  # width and height of the figure below its title [inch]
    fill: Fill  # draws all panels in the figure, as `panels` makes it
    data: Table  # all data that the figure shows, in SI units
    title: str = ""

    def figure(self) -> Figure:
        """Draw the chart as a Matplotlib figure, without a banner."""
        figure = sheet(*self.size, self.title)
        self.fill(figure)
        return figure

    def table(self) -> Table:
        """Return all data that the figure shows, in SI units."""
        return self.data

    def save(self, *paths: str | Path, banner: str = "") -> None:
        """Draw the chart and save it to files (`.pdf`, `.svg` or `.png`).

        The banner is at the top, for simulated experiments. Another ending raises `InvalidInput`.
        """

        def make() -> Figure:
            figure = self.figure()
            if banner:
                add_banner(figure, banner)
            return figure

        save_figure(make, *paths)


def panel(
    *marks: Mark,
    title: str = "",
    log: Mapping[str, FloatArray] = MappingProxyType({}),
    whole: str = "",
    rows: Sequence[str] = (),
    **settings: Any,
) -> Mark:
    """Return a function that draws a panel: marks, in order, and then its axes.

    Marks draw in axes, such as `line(x, y, color=...)`. Axes "x" and "y" in `log` are logarithmic
    about values (n,), and those in `whole` have whole numbers. Rows are named from above. Settings
    are labels and limits, as for `matplotlib.axes.Axes.set`.
    """

    def draw(axes: Axes) -> None:
        for mark in marks:
            mark(axes)
        for which, values in log.items():
            log_scale(axes, which, values)
        for which in whole:
            whole_numbers(axes, which)
        if rows:
            axes.set_yticks(range(len(rows)), rows)
            axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.set(**settings)
        axes.set_title(title, fontsize=palette.FONT_SIZE)
        clean(axes)

    return draw


def panels(rows: Sequence[Sequence[Mark]], legend: int = 9, **options: Any) -> Fill:
    """Return a function that draws rows of panels, with one legend below them.

    The last row may be shorter than the others, and the legend has at most `legend` labels per row;
    0 for no legend. Options are those of `matplotlib.figure.Figure.subplots`.
    """

    def fill(figure: Figure) -> None:
        grid = figure.subplots(len(rows), len(rows[0]), squeeze=False, **options)
        for axes, draw in zip_longest(grid.flat, chain(*rows)):
            axes.set_visible(False) if draw is None else draw(axes)
        figure.align_ylabels(grid[:, 0])
        if legend:
            legend_below(figure, grid.flat, legend)

    return fill


def in_rows(every: Sequence[Mark], columns: int) -> list[Sequence[Mark]]:
    """Arrange panels in rows."""
    return [every[k : k + columns] for k in range(0, len(every), columns)]


def plot(draw: Callable[..., Any], found: Any, ax: Axes | None, options: dict[str, Any]) -> Any:
    """Draw a result for its method `plot`, and return the axes.

    The function `draw` makes a chart or a figure, or has an argument `ax` and returns axes.
    """
    if "ax" in signature(draw).parameters:
        return draw(found, ax=ax, **options)

    def figure() -> Figure:
        made = draw(found, **options)
        return made.figure() if isinstance(made, Chart) else made

    return plot_axes(figure, ax)


def save_figure(make: Callable[[], Figure], *paths: str | Path) -> None:
    """Create a figure in the house style and save it to files, each whole or not at all.

    Another ending than `.pdf`, `.svg` or `.png` raises `InvalidInput`.
    """
    import matplotlib as mpl

    for path in paths:
        refuse_ending(path, PICTURE_ENDINGS, "picture")
    # Without the creation time, equal data give equal files.
    known: Style = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
        figure = _laid_out(make)
        for path in paths:
            # In memory: Matplotlib hides the error of a full disk behind one of its own.
            ending, content = Path(path).suffix.lower(), BytesIO()
            figure.savefig(content, format=ending[1:], metadata=known.get(ending))
            write_whole(path, content.getvalue())
            figure.set_layout_engine(None)  # all files have the layout of the first


def _laid_out(make: Callable[[], Figure]) -> Figure:
    """Create a figure; with axes of equal scales, constrained layout settles in its second pass."""
    figure = make()
    if any(axes.get_aspect() != "auto" for axes in figure.axes):
        figure.draw_without_rendering()
    return figure


# Whether figures are made by Pyplot, which shows them in notebooks and windows.
_BY_PYPLOT: ContextVar[bool] = ContextVar("_BY_PYPLOT", default=False)


def plot_axes(make: Callable[[], Figure], ax: Axes | None = None) -> Any:
    """Create a figure in the house style for the `plot` method of a result; return its axes.

    The figure is created by `sheet`, and Pyplot knows it, so that notebooks show it. Axes `ax` that
    the caller of `plot` gave are rejected: the figure has axes of its own.
    """
    import matplotlib as mpl

    if ax is not None:
        raise InvalidInput("ax", found="axes", expected="none: this plot makes its own figure")
    token = _BY_PYPLOT.set(True)
    try:
        with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
            figure = _laid_out(make)
    finally:
        _BY_PYPLOT.reset(token)
    return figure.axes[0] if len(figure.axes) == 1 else np.array(figure.axes, dtype=object)


def new_figure(**options: Any) -> Figure:
    """Create a figure; by Pyplot within `plot_axes`."""
    if _BY_PYPLOT.get():
        from matplotlib import pyplot

        return pyplot.figure(dpi=SCREEN_DPI, **options)
    from matplotlib.figure import Figure

    return Figure(**options)


def require_file(
    path: Path | None, endings: Sequence[str] = PICTURE_ENDINGS, what: str = "picture"
) -> None:
    """Raise `InvalidInput`, before any work, for a file that is to be written but cannot be."""
    if path is not None:
        refuse_ending(path, endings, what)
        refuse_unwritable(path)


def sheet(width: float, height: float, title: str = "") -> Figure:
    """Create an empty figure [inch] with constrained layout, below a title."""
    above = HEAD if title else 0.0
    figure = new_figure(figsize=(width, height + above), layout="constrained")
    room = height / (height + above)
    engine: Any = figure.get_layout_engine()
    engine.set(w_pad=0.06, h_pad=0.05, rect=(0.0, 0.0, 1.0, room))
    if title:
        place, size = 0.5 * (1.0 + room), palette.FONT_SIZE + 1.0
        figure.text(0.5, place, shorten(title, 90), ha="center", va="center", fontsize=size)
    return figure


def add_banner(figure: Figure, text: str) -> None:
    """Draw a band with text over a figure with constrained layout, which grows by its height."""
    from matplotlib.patches import Rectangle

    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + BANNER)
    share = BANNER / (height + BANNER)
    for title in figure.texts:
        title.set_y(title.get_position()[1] * (1.0 - share))
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0.0, 0.0, 1.0, engine.get()["rect"][3] * (1.0 - share)))
    band: Style = {"facecolor": palette.FORCE, "linewidth": 0.0}
    figure.add_artist(Rectangle((0.0, 1.0 - share), 1.0, share, **band))
    figure.text(0.5, 1.0 - 0.52 * share, text, color="white", weight="bold", ha="center",
                va="center")  # fmt: skip


def clean(axes: Axes) -> None:
    """Draw a faint grid behind the data, and hide the upper and right spines."""
    axes.grid(color=palette.FAINT, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(pad=1.5)


# Smallest and largest number on a logarithmic axis.
MIN_DRAWN: Final = 1e-100
MAX_DRAWN: Final = 1e100


def log_scale(axes: Axes, which: str, values: FloatArray) -> None:
    """Set a logarithmic axis around positive values, with tick labels even within one decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    good = values[np.isfinite(values) & (values > 0.0)]
    low, high = (float(good.min()), float(good.max())) if len(good) else (0.1, 10.0)
    # Beyond these values the limits would overflow.
    low, high = min(max(low, MIN_DRAWN), MAX_DRAWN), min(max(high, MIN_DRAWN), MAX_DRAWN)
    wide = high / low
    margin = max(wide**0.06, 1.15)
    getattr(axes, f"set_{which}scale")("log")
    getattr(axes, f"set_{which}lim")(low / margin, high * margin)
    axis = getattr(axes, f"{which}axis")
    subs = (1.0,) if wide > 200.0 else (1.0, 2.0, 5.0) if wide > 5.0 else tuple(range(1, 10))
    axis.set_major_locator(LogLocator(subs=subs, numticks=8))
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def mark_missing(places: Any, share: float, which: str = "x", **style: Any) -> Mark:
    """Return a mark with crosses for what could not be simulated, at a share of the other axis.

    `which` is the axis that the places belong to.
    """
    look: Style = {"marker": "x", "color": palette.FORCE, "markersize": 4.0, "linestyle": "none"}
    look |= style
    far = np.full(len(places), share)

    def draw(axes: Axes) -> None:
        if len(places) and which == "x":
            axes.plot(places, far, transform=axes.get_xaxis_transform(), **look)
        elif len(places):
            axes.plot(far, places, transform=axes.get_yaxis_transform(), **look)

    return draw


def whole_numbers(axes: Axes, which: str = "x") -> None:
    """Label an axis with whole numbers."""
    from matplotlib.ticker import MaxNLocator

    locator = MaxNLocator(nbins=6, integer=True, min_n_ticks=1)
    getattr(axes, f"{which}axis").set_major_locator(locator)


def legend_below(figure: Figure, row: Iterable[Axes], most: int = 9) -> None:
    """Draw one legend for all panels, with at most `most` labels per row and no repeated ones."""
    entries: dict[str, Any] = {}
    for axes in row:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if not entries:
        return
    figure.legend(
        list(entries.values()),
        list(entries),
        frameon=False,
        ncols=min(most, len(entries)),
        loc="outside lower center",
        handlelength=2.0 if len(entries) <= most else 2.6,
    )


def legend_of(figure: Figure, handles: Sequence[Any], columns: int = 0, **style: Any) -> int:
    """Draw a legend below everything, by default in two or three columns; return its rows."""
    columns = columns or (3 if max(len(str(h.get_label())) for h in handles) < 18 else 2)
    look: Style = {"frameon": False, "handlelength": 1.7, "columnspacing": 1.2, "borderpad": 0.0}
    look |= {"labelspacing": 0.3, "handletextpad": 0.5, "loc": "outside lower center", **style}
    figure.legend(handles=list(handles), ncols=columns, **look)
    return -(-len(handles) // columns)


def positive(values: FloatArray) -> FloatArray:
    """Prepare values for a logarithmic axis: zeros become half the smallest, infinite ones NaN."""
    good = values[np.isfinite(values) & (values > 0.0)]
    least = 0.5 * float(good.min()) if len(good) else 1.0
    return np.where(np.isfinite(values), np.maximum(values, least), np.nan)


def column_unit(unit: str) -> str:
    """Format a unit as the end of a column's name."""
    return unit.replace("^", "")


def broken(label: str) -> str:
    """Break a label before a bracket into two lines."""
    return label.replace("[", "\n[", 1)


def tint(colour: str, strength: float) -> tuple[float, float, float]:
    """Mix a colour with white; `strength` is the share of the colour."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1.0 - strength * (1.0 - c) for c in to_rgb(colour))
    return red, green, blue


def shorten(text: str, most: int) -> str:
    """Shorten a name to at most `most` characters: first drop the dataset, then the beginning."""
    if len(text) > most:
        text = text.partition("/")[2] or text
    return text if len(text) <= most else "…" + text[1 - most :]
