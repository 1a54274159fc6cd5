"""Complete tasks of a user: simulate a file, calibrate, map, report, demonstrate, check."""
