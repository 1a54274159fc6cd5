"""Files that survive crashes: whole writes, locks, journals, documents, kept results."""
