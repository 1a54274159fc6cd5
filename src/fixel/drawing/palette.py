"""One colour per role, from a palette that colour-blind readers can distinguish.

Source: M. Okabe, K. Ito (2008), Color universal design. The colours differ in lightness as well, so
that figures stay readable in black and white.
"""

from typing import Final

BODY: Final = "#0072B2"  # blue
PUSHER: Final = "#E69F00"  # orange
FIXEL: Final = "#7F7F7F"  # grey
TOUCHED: Final = "#009E73"  # bluish green: a fixel that was touched
FORCE: Final = "#D55E00"  # vermilion
TRAIL: Final = "#56B4E9"  # sky blue
CONE: Final = "#CC79A7"  # reddish purple
INK: Final = "#222222"
FAINT: Final = "#D9D9D9"

FONT_SIZE: Final = 7.0  # [pt], for a figure of one column
COLUMN: Final = 3.5  # [inch], width of one column

STYLE: Final = {
    "font.family": "sans-serif",
    "font.size": FONT_SIZE,
    "axes.labelsize": FONT_SIZE,
    "axes.titlesize": FONT_SIZE + 1.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "xtick.labelsize": FONT_SIZE,
    "ytick.labelsize": FONT_SIZE,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": FONT_SIZE - 0.5,
    "pdf.fonttype": 42,  # embed fonts: journals reject text converted to outlines
    "svg.fonttype": "none",
    "savefig.dpi": 300,
    # Names come from files: they are no formulas, nor programs of TeX.
    "text.parse_math": False,
    "text.usetex": False,
}
