"""Calibrate stored experiments: request, job, result."""
