"""Base of charts with their data as tables, and helpers for drawing them."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel.drawing import palette
from fixel.errors import InvalidInput
from fixel.table import Table
from fixel.typing import FloatArray
from fixel.units import displayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Style = dict[str, Any]

WIDE: Final = 7.16  # [inch], two columns of text
HEAD: Final = 0.22  # [inch]
SCREEN_DPI: Final = 150.0
BANNER: Final = 0.20  # height of a banner [inch]
PICTURE_ENDINGS: Final = (".pdf", ".png", ".svg")


class AbstractChart(abc.ABC):
    """Base class of charts: a figure and its data as a table."""

    @abc.abstractmethod
    def figure(self) -> Figure:
        """Draw the chart as a Matplotlib figure, without a banner."""

    @abc.abstractmethod
    def table(self) -> Table:
        """Return all data that the figure shows, in SI units."""


def draw_chart(chart: AbstractChart, *paths: str | Path, banner: str = "") -> None:
    """Draw a chart and save it to files.

    Parameters
    ----------
    chart : AbstractChart
    *paths : str or Path
        Files to write (`.pdf`, `.svg` or `.png`).
    banner : str
        Text of a banner at the top, for simulated experiments.

    Raises
    ------
    InvalidInput
        A file name has another ending.
    """

    def make() -> Figure:
        figure = chart.figure()
        if banner:
            add_banner(figure, banner)
        return figure

    save_figure(make, *paths)


def save_figure(make: Callable[[], Figure], *paths: str | Path) -> None:
    """Create a figure in the house style and save it; reject other endings than of pictures."""
    import matplotlib as mpl

    for path in paths:
        refuse_ending(path, PICTURE_ENDINGS, "picture")
    # Without the creation time, equal data give equal files.
    known: Style = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
        figure = _laid_out(make)
        for path in paths:
            ending = Path(path).suffix.lower()
            with _fonts_without_layout() if ending == ".pdf" else nullcontext():
                figure.savefig(path, metadata=known.get(ending))
            figure.set_layout_engine(None)  # all files have the layout of the first


@contextmanager
def _fonts_without_layout() -> Iterator[None]:
    """Embed fonts without their tables for the layout of text, which PDF files do not use.

    To read these tables and to reduce them takes most of the time of a PDF file.
    """
    from fontTools.subset import Subsetter

    whole = Subsetter.subset

    def subset(self: Any, font: Any) -> None:
        for name in {"GDEF", "GPOS", "GSUB", "kern"}.intersection(font.keys()):
            del font[name]
        whole(self, font)

    Subsetter.subset = subset
    try:
        yield
    finally:
        Subsetter.subset = whole


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

    Parameters
    ----------
    make : callable
        Function that draws the figure, which it creates by `sheet`.
    ax : None
        Axes that the caller of `plot` gave. They are rejected: the figure has axes of its own.

    Returns
    -------
    matplotlib.axes.Axes, or (n,) array of them
        Known to Pyplot, so that notebooks show them.
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


def save_filled(fill: Callable[[Figure], None], path: str | Path) -> None:
    """Save a figure in the house style with constrained layout, whose content `fill` draws."""

    def make() -> Figure:
        figure = new_figure(layout="constrained")
        fill(figure)
        return figure

    save_figure(make, path)


def refuse_ending(path: str | Path, endings: Sequence[str], what: str) -> None:
    """Raise `InvalidInput` for a file name whose ending is not one of `endings`."""
    if Path(path).suffix.lower() not in endings:
        raise InvalidInput(
            str(path),
            found=f"the ending {Path(path).suffix!r}" if Path(path).suffix else "no ending",
            expected=f"a {what} file: " + ", ".join(endings),
        )


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


def room_above(axes: Axes, wanted: bool) -> None:
    """Raise the upper limit of a logarithmic axis, if wanted, for marks of failures."""
    if wanted:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.06)


def mark_missing(axes: Axes, places: Any, share: float, which: str = "x", **style: Any) -> None:
    """Draw crosses for what could not be simulated, at a share of the other axis; none if empty.

    `which` is the axis that the places belong to.
    """
    if not len(places):
        return
    look: Style = {"marker": "x", "color": palette.FORCE, "markersize": 4.0, "linestyle": "none"}
    far = np.full(len(places), share)
    if which == "x":
        axes.plot(places, far, transform=axes.get_xaxis_transform(), **(look | style))
    else:
        axes.plot(far, places, transform=axes.get_yaxis_transform(), **(look | style))


def whole_numbers(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True, min_n_ticks=1))


def legend_below(figure: Figure, row: Iterable[Axes], most: int = 9) -> None:
    """Draw one legend for all panels, with at most `most` labels per row and no repeated ones."""
    entries: dict[str, Any] = {}
    for axes in row:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
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


class DisplayUnit(NamedTuple):
    """Display unit and its factor from SI."""

    name: str  # empty for no unit
    factor: float  # from SI to this unit

    def on(self, label: str) -> str:
        """Append the unit to a label."""
        return f"{label} [{self.name}]" if self.name else label

    def text(self, value: float) -> str:
        """Format a value in this unit, without the unit's name."""
        return f"{self.factor * value:.3g}"


def display_unit(unit: str) -> DisplayUnit:
    """Return the display unit, such as millimetres and degrees instead of metres and radians."""
    name, factor = displayed(unit)
    return DisplayUnit(unit_text(name), factor)


def unit_text(unit: str) -> str:
    """Format a unit with a superscript square."""
    return unit.replace("^2", "²")


def column_unit(unit: str) -> str:
    """Format a unit as the end of a column's name."""
    return unit.replace("^", "")


def broken(label: str) -> str:
    """Break a label before a bracket into two lines."""
    return label.replace("[", "\n[", 1)


def cut_short(text: str, most: int = 44) -> str:
    """Cut a text to at most `most` characters, with an ellipsis."""
    return text if len(text) <= most else text[: most - 1] + "…"


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


def without_common(names: Sequence[str]) -> list[str]:
    """Remove the dataset from names, if all of them share it."""
    heads = {name.partition("/")[0] for name in names}
    alike = len(heads) == 1 and all("/" in name for name in names)
    return [name.partition("/")[2] if alike else name for name in names]


def finite_list(values: FloatArray) -> list[float | None]:
    """Convert an array to a list, with None for numbers that are not finite."""
    return [value if math.isfinite(value) else None for value in values.tolist()]
