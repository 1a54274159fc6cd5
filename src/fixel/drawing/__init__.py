"""Figures and animations of scenes and simulations."""
