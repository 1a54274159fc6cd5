"""Command line: parse arguments, call a workflow, print the result."""
