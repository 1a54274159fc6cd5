"""Acquire experiments with a camera: record, track, overlay, drive, and rendered films."""
