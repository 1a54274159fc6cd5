"""Exploration of the domain of applicability as in the thesis, from stored calibrations."""
