"""Suggest corrections for a filter that matches nothing."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from fixel.database.query import COLUMNS, Bound, ExperimentQuery
from fixel.database.store import Store
from fixel.errors import InvalidInput
from fixel.workflows.project.filters import NAMES, view_of

MAX_NAMED = 12  # values listed in an error


class UnknownName(NamedTuple):
    """Name or value that no experiment has."""

    what: str  # as typed: "--where shape"
    typed: str
    known: tuple[str, ...]

    @property
    def meant(self) -> str | None:
        """Known name that resembles it most; None if none does."""
        close = difflib.get_close_matches(self.typed.lower(), [k.lower() for k in self.known], n=1)
        return next((k for k in self.known if k.lower() == close[0]), None) if close else None

    def refusal(self) -> InvalidInput:
        """Return the error to raise."""
        more = f", ... ({len(self.known)} in all)" if len(self.known) > MAX_NAMED else ""
        return InvalidInput(
            self.what,
            found=repr(self.typed),
            expected="one of " + ", ".join(self.known[:MAX_NAMED]) + more
            if self.known
            else "nothing: no experiment has one",
            hint=f"did you mean {self.meant!r}?" if self.meant else None,
        )


def refuse_mistyped(store: Store, query: ExperimentQuery) -> None:
    """Raise if a query has a dataset, flag, condition or value that no experiment has.

    Raises
    ------
    InvalidInput
        Error for the first of them, with the known name that resembles it most.
    """
    for unknown in _unknown_in(store, query):
        raise unknown.refusal()


def meant_filter(store: Store, filter: str) -> str | None:
    """Return a filter with unknown names and values replaced by what resembles them.

    Returns
    -------
    str or None
        None if nothing is unknown, or nothing resembles it.
    """
    view = view_of(filter)
    changed = filter
    for unknown in _unknown_in_view(store, view):
        if unknown.meant is None:
            return None
        changed = changed.replace(unknown.typed, unknown.meant, 1)
    return changed if changed != filter else None


def _unknown_in(store: Store, query: ExperimentQuery) -> Iterator[UnknownName]:
    if query.dataset is not None:
        yield from _not_among("--dataset", query.dataset, store.datasets())
    for name in query.flags:
        yield from _not_among("--flag", name, store.flags())
    yield from _unknown_conditions(store, query.conditions, "--where ")


def _unknown_in_view(store: Store, view: ExperimentQuery) -> Iterator[UnknownName]:
    for name in view.flags:
        yield from _not_among("flag", name, store.flags())
    texts = [text for known in store.conditions().values() for text in known.texts]
    for word in view.words:
        yield from _not_among("filter", word, (*texts, *store.datasets(), *store.flags()))
    for bound in view.bounds:
        if bound.name == "dataset":
            yield from _not_among("dataset", str(bound.value), store.datasets())
    others = [bound for bound in view.bounds if bound.name not in COLUMNS]
    yield from _unknown_conditions(store, others, "", NAMES)


def _unknown_conditions(
    store: Store, bounds: Iterable[Bound], where: str, more: Iterable[str] = ()
) -> Iterator[UnknownName]:
    known = store.conditions()
    for bound in bounds:
        if bound.name not in known:
            yield UnknownName(where.strip() or "filter", bound.name, (*known, *more))
        elif isinstance(bound.value, str) and bound.relation == "=":
            yield from _not_among(f"{where}{bound.name}", bound.value, known[bound.name].texts)


def _not_among(what: str, typed: str, known: Iterable[str]) -> Iterator[UnknownName]:
    if typed not in (names := tuple(known)):
        yield UnknownName(what, typed, names)
