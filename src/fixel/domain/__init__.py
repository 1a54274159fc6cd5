"""Where a calibrated simulator can be trusted: growth, maps, promises; no files."""
