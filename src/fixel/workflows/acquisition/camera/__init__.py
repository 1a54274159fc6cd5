"""Calibrate, import, place and check cameras; print boards and tags for this."""
