"""Data for the pages: forms, progress, details, lists."""
