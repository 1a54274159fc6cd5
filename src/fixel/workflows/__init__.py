"""The order of a day's work: simulate a file, replay a dataset, demo, doctor."""
