"""The thesis's exploration of where one set of parameters serves, from stored calibrations."""
