"""Emulated devices: the demonstration and tests run the drivers of the testbed without hardware."""
