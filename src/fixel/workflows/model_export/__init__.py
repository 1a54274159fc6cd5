"""Models for other engines: files, a program that runs them, and their distance from fixel."""
