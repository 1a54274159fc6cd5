"""Conformance test suites, emulated devices and example scenes, for fixel and for plug-ins."""
