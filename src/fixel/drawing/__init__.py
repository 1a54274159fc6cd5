"""Figures and animations of simulations; Matplotlib is imported when the first one is drawn."""

from fixel.drawing.animation import animate_simulation
from fixel.drawing.picture import draw_simulation

__all__ = ["animate_simulation", "draw_simulation"]
