"""Sensitivity of a push to its start: compute and report."""
