"""Filter a recorded run, and report what it finds."""
