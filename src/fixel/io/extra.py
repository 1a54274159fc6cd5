"""Packages of extras, imported when a file needs them."""

from importlib import import_module
from typing import Any

from fixel.errors import MissingExtra


def extra_module(feature: str, module: str, package: str, extra: str = "files") -> Any:
    """Import a module of a package that an extra installs.

    Raises
    ------
    MissingExtra
        The package is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtra(feature, package, extra=extra) from None
