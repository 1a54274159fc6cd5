"""Colours of the figures as CSS, from the palette of the drawings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from fixel.drawing import palette

ROLES: Final = {
    "body": palette.BODY,
    "pusher": palette.PUSHER,
    "fixel": palette.FIXEL,
    "touched": palette.TOUCHED,
    "force": palette.FORCE,
    "trail": palette.TRAIL,
    "cone": palette.CONE,
}
# Backgrounds of text; the same as --card in style.css.
LIGHT: Final = "#ffffff"
DARK: Final = "#1b2127"
# Colours of the probabilities 0, 1/2 and 1.
NO: Final = "#8c2d04"
UNDECIDED: Final = "#f5f0e6"
YES: Final = "#005fa0"
READABLE: Final = 4.6  # contrast of text; WCAG AA asks for 4.5
VISIBLE: Final = 3.1  # contrast of lines; WCAG AA asks for 3.0

Colour = tuple[float, float, float]


def palette_css() -> str:
    """Return variables `--body` etc. for lines, `--body-text` etc. for text, in light and dark."""
    light = "\n".join(_lines(LIGHT))
    dark = "\n".join(_lines(DARK))
    return (
        "/* Made from fixel.drawing.palette. */\n"
        f":root {{\n{light}\n}}\n@media (prefers-color-scheme: dark) {{\n:root {{\n{dark}\n}}\n}}\n"
        + "\n".join(map(_of_probability, range(101)))
    )


def _of_probability(percent: int) -> str:
    """Return the rule of a class for a probability: brown over pale to blue.

    It is pale where little is known, so that what is decided stands out.
    """
    to, share = NO if percent < 50 else YES, abs(2 * percent / 100 - 1) ** 2.5
    mixed = (c + (t - c) * share for c, t in zip(_rgb(UNDECIDED), _rgb(to), strict=True))
    colour = _text_of(mixed)
    ink = "#101418" if _lightness(colour) > 0.18 else "#ffffff"
    return f".p{percent} {{ background: {colour}; color: {ink}; }}"


def _lines(ground: str) -> list[str]:
    lines = []
    for role, colour in ROLES.items():
        lines.append(f"  --{role}: {readable(colour, ground, VISIBLE)};")
        lines.append(f"  --{role}-text: {readable(colour, ground, READABLE)};")
    return lines


def readable(colour: str, ground: str, contrast: float) -> str:
    """Mix a colour with black or white until it contrasts with its background."""
    against = 0.0 if _lightness(ground) > 0.5 else 1.0
    for share in range(0, 101, 2):
        text = _text_of(c + (against - c) * share / 100 for c in _rgb(colour))
        if contrast_of(text, ground) >= contrast:
            return text
    return text


def contrast_of(one: str, other: str) -> float:
    """Contrast ratio as WCAG 2.2 defines it, from 1 to 21."""
    high, low = sorted((_lightness(one), _lightness(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def _lightness(colour: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in _rgb(colour)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _text_of(colour: Iterable[float]) -> str:
    return "#" + "".join(f"{round(255 * c):02x}" for c in colour)


def _rgb(colour: str) -> Colour:
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue
