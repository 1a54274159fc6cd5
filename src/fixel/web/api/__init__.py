"""What programs ask for, below `/api/v1`: one module a resource.

A module has `router(desk) -> APIRouter`. Its handlers are thin and plain functions, which run
beside the server's loop: they ask the store and the workflows, and answer with models. What several
modules need is in modules whose names begin with `_`.
"""
