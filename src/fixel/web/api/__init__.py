"""API for programs, below `/api/v1`: one module per resource.

A module has `router(desk) -> APIRouter`. Its handlers are thin, plain functions, which run in
threads outside the server's loop: they call the store and the workflows, and answer with models.
Code that several modules need is in modules whose names begin with `_`.
"""
