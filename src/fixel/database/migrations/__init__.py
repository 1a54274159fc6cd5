"""Migrations, one module per schema version; `schema.py` applies them."""
