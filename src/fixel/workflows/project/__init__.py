"""Work on a project: import, export, filter, compare, maintain."""
