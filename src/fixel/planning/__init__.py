"""Open-loop pushes that reach a goal despite what is unknown, with their success probability."""
