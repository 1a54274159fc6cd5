"""Banner at the top of figures of simulated experiments, and shortening of titles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from fixel.drawing import palette

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BANNER: Final = 0.20  # height [inch]


def add_band(figure: Figure, text: str, share: float) -> None:
    """Draw a band with text over the top `share` of a figure."""
    from matplotlib.patches import Rectangle

    figure.add_artist(
        Rectangle((0.0, 1.0 - share), 1.0, share, facecolor=palette.FORCE, linewidth=0.0)
    )
    place = 1.0 - 0.52 * share
    figure.text(0.5, place, text, color="white", weight="bold", ha="center", va="center")


def add_simulated_band(figure: Figure, simulated_by: str, share: float) -> None:
    """Draw a band over the top `share` of a figure that names the simulator of the experiment."""
    add_band(figure, f"SIMULATED by {cut_short(simulated_by)}", share)


def cut_short(text: str, most: int = 44) -> str:
    """Cut a text to at most `most` characters, with an ellipsis."""
    return text if len(text) <= most else text[: most - 1] + "…"
