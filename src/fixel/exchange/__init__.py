"""The outside world: scene files, trajectory files, public datasets."""
