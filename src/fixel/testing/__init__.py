"""Conformance suites and example scenes, for fixel and for authors of plug-ins."""
