"""Parts that have hardly been pushed: predictions from other parts, with bounds."""
