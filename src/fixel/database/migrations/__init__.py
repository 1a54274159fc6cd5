"""The schema, version by version; `schema.py` applies them."""
