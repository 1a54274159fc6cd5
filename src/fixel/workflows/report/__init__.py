"""One page to hand over: what was measured, what was calibrated, how far to believe it."""
