"""API for programs, below `/api/v1`: one module per resource.

A module has a `router`. Its routes are thin, plain functions, which run in threads outside the
server's loop: they get the project as their parameter `context`, call the store and the workflows,
and return models.
"""
