"""Web server on this machine, for the pages of a project and for live pictures."""

from importlib.util import find_spec

from fixel.errors import InvalidInput


def require_server() -> None:
    """Raise, before any work, if packages of the server are missing."""
    missing = [name for name in ("fastapi", "uvicorn") if find_spec(name) is None]
    if missing:
        raise InvalidInput(
            f"pages in a browser need the packages {' and '.join(missing)}",
            hint="pip install 'fixel[web]'",
        )
