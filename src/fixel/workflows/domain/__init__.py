"""Domain of applicability: held-out errors, a map of them, its charts, the stored result."""
