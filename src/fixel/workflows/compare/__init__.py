"""Comparison of a stored experiment with its simulation: run and report."""
