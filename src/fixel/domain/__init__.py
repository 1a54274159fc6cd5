"""Domain of applicability of a calibrated simulator: growth, maps, error bounds; no files."""
