"""Figures of published results repeated."""
