"""The bench: perform a plan of experiments on real hardware, and calibrate while it runs."""
