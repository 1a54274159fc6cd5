"""Sentences of reports, from text templates that can be read and edited.

A template is a file in `report/templates`. Each of its blocks (`headline`, `warnings`, `methods`)
is a list: a line that begins with `- ` begins a sentence, and line breaks within one are spaces.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from fixel.model import Experiment

_BEGINNING: Final = re.compile(r"(?m)^\s*- ")
NOTHING: Final = 1e-7  # [mm or deg] smaller values are shown as zero


def sentences(template: str, block: str, **values: Any) -> tuple[str, ...]:
    """Render a block of a template, such as `growth`, and return its sentences.

    The values are the variables of the block; a missing one is an error.
    """
    own = environment().get_template(f"{template}.txt")
    text = "".join(own.blocks[block](own.new_context(values)))
    return tuple(" ".join(part.split()) for part in _BEGINNING.split(text)[1:])


@cache
def environment() -> Any:
    """Create the environment of the templates; it escapes what goes into HTML, as names of
    experiments may contain anything.

    Filters: `fmt(".3g")` formats a number, `mm` and `deg` convert metres and radians, `s` is the
    ending of a plural, `rounded` shows numbers below any measurement as zero.
    """
    import jinja2

    found = jinja2.Environment(
        loader=jinja2.PackageLoader("fixel.workflows", "report/templates"),
        autoescape=jinja2.select_autoescape(),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {
        "fmt": lambda value, how: format(value, how),
        "mm": lambda metres: 1e3 * metres,
        "deg": math.degrees,
        "s": lambda count: "" if count == 1 else "s",
        "rounded": rounded,
    }
    return found


def rounded(value: float, digits: int = 3) -> str:
    """Format a length [mm], an angle [deg] or a share for people to read; values below any
    measurement, such as rounding errors of simulations, are zero."""
    return f"{value if abs(value) >= NOTHING else 0.0:.{digits}g}"


def origin_of(experiment: Experiment) -> str:
    """Return the name of an experiment, and whether it is real."""
    what = "real" if experiment.real else f"SIMULATED by {experiment.simulated_by}"
    return f"{experiment.key}: {what}"
