"""Registry of what upper floors offer: plots, stores, file formats, workflows.

A lower floor knows only this module; `fixel.offers` fills it when `fixel` is imported. What is
offered is imported when it is first used.
"""

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final

_OFFERS: Final[dict[str, dict[str, str]]] = {}


def register(kind: str, offers: Mapping[str, str]) -> None:
    """Add offers of a kind, each `"module:attribute"` or a module by its name."""
    _OFFERS.setdefault(kind, {}).update(offers)


def offers(kind: str) -> Mapping[str, str]:
    """Return the offers of a kind by name, in the order of their registration."""
    return MappingProxyType(_OFFERS.get(kind, {}))


def offered(kind: str, name: str) -> Any:
    """Return what is registered under a kind and a name, imported."""
    module, _, attribute = _OFFERS[kind][name].partition(":")
    found = import_module(module)
    return getattr(found, attribute) if attribute else found
