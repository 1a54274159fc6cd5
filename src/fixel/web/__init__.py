"""Pages in a browser: a small server on this machine, and the live pictures it shows."""

from importlib.util import find_spec

from fixel.errors import InvalidInput


def require_server() -> None:
    """Refuse, before any work, where the packages of the server are missing."""
    missing = [name for name in ("fastapi", "uvicorn") if find_spec(name) is None]
    if missing:
        raise InvalidInput(
            f"pages in a browser need the packages {' and '.join(missing)}",
            hint="pip install 'fixel[web]'",
        )
