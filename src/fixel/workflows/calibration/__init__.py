"""Calibrations of stored experiments: what is asked, the work, what was found."""
