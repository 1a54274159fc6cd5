"""Estimates of poses and parameters while a run goes on."""
