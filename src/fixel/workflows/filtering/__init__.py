"""Estimation of poses and parameters frame by frame: run and report."""
