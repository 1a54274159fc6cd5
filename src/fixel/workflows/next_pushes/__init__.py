"""Propose the next pushes of a part of a project."""
