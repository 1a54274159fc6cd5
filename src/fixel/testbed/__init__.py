"""Instruments of the testbed, and a simulated testbed to work without them."""
