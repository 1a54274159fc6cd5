"""Files that survive crashes: atomic writes, locks, journals, documents, cached results."""
