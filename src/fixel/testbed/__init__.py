"""The bench: instruments, and a simulated laboratory that stands in for one."""
