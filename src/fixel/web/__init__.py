"""Web server on this machine, for the pages of a project and for live pictures."""
