"""Uncertainty of parameters after a calibration, and its effect on predictions."""
