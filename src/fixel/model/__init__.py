"""What there is: shapes, bodies, pushers, fixels, scenes; checked when built."""
