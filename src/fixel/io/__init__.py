"""Files that survive crashes: atomic writes, locks, journals, documents, saved results."""

from fixel.io.saved import load, save

__all__ = ["load", "save"]
