"""Storage of experiments: a project folder, its database and its media files."""
