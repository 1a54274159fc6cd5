"""Cameras: calibrated, imported, placed, checked; and the prints for it."""
