"""Where experiments are kept: a project folder, its database and its media."""
