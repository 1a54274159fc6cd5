"""Parts that have hardly been pushed: what other parts teach about them, and how far off it may be."""
