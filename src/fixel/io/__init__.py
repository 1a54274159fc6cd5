"""Files that survive crashes: atomic writes, locks, journals, documents, saved results."""
