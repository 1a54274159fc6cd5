"""Demonstrations: one scene, a simulated laboratory, a rendered camera."""
