"""From a camera to experiments: record, track, overlay, drive, and rendered films."""
