"""Immutable, filterable sequence of experiments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from math import degrees
from pathlib import Path
from typing import Any, NamedTuple, final, overload

import numpy as np

from fixel.errors import InvalidInput, quoted, unknown_name
from fixel.model import Experiment, selection
from fixel.model.fields import instance, whole
from fixel.model.records import SimulationRecord
from fixel.model.scene import SceneChoice
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.units import length_unit

MAX_LISTED = 20  # experiments that a summary lists


class ExperimentEntry(NamedTuple):
    """One of several experiments: its facts, and the experiment unless it is read when needed."""

    row: selection.ExperimentRow
    details: selection.ExperimentDetails
    experiment: Experiment | None = None


@final
@dataclass(frozen=True, repr=False, eq=False)
class Experiments(Result, Sequence[Experiment]):
    """Experiments, as `read_experiments` reads them or a project stores them.

    Filters, samples and splits return other sequences; nothing is modified. Experiments of a
    project are read from it one by one, when they are used.

    Parameters
    ----------
    entries : tuple of ExperimentEntry
    load : callable, optional
        Function that returns the experiment with an id, for entries without one.
    notes : tuple of str
        How the source was interpreted: units, frames, guesses.
    skipped : tuple of str
        Experiments of the source that were left out, with the reason.
    simulations : mapping of str to SimulationRecord
        Simulations by the publisher of the data, for some of the experiments by their full name.
        `fixel.compare(experiments, {"laboratory": experiments.simulations})` computes their errors.

    Examples
    --------
    >>> import fixel
    >>> pushes = fixel.datasets.example()
    >>> len(pushes), pushes[0].key
    (40, 'example/00')
    >>> train, test = pushes.split(test=10)
    >>> [len(train), len(test), len(pushes.where("moved>50"))]
    [30, 10, 13]
    """

    entries: tuple[ExperimentEntry, ...] = ()
    load: Callable[[int], Experiment] | None = field(default=None, compare=False)
    notes: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    simulations: Mapping[str, SimulationRecord] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        experiments: Experiment | Iterable[Experiment],
        notes: Sequence[str] = (),
        skipped: Sequence[str] = (),
        simulations: Mapping[str, SimulationRecord] | None = None,
    ) -> Experiments:
        """Make a sequence of one experiment, or of several in memory.

        Parameters
        ----------
        experiments : Experiment or iterable of Experiment
        notes, skipped : sequence of str
        simulations : mapping of str to SimulationRecord, optional

        Returns
        -------
        Experiments
            The same object if it is one already.
        """
        if isinstance(experiments, Experiments):
            return experiments
        instance(experiments, Experiment | Iterable, "experiments", "a list of experiments")
        several = [experiments] if isinstance(experiments, Experiment) else [*experiments]
        for k, one in enumerate(several):
            instance(one, Experiment, f"experiments[{k}]", "an Experiment")
        entries = (
            ExperimentEntry(*selection.described(one, k), one) for k, one in enumerate(several)
        )
        return cls(tuple(entries), None, tuple(notes), tuple(skipped), dict(simulations or {}))

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int | str) -> Experiment: ...
    @overload
    def __getitem__(self, index: slice) -> Experiments: ...
    def __getitem__(self, index: int | str | slice) -> Experiment | Experiments:
        if isinstance(index, slice):
            return self._with(self.entries[index])
        if isinstance(index, str):  # a name, or dataset/name
            rows = enumerate(entry.row for entry in self.entries)
            own = {k: row.key for k, row in rows if index in (row.name, row.key)}
            if len(own) != 1:
                raise unknown_name("experiments", index, tuple(own.values()) or self.keys)
            (index,) = own
        entry = self.entries[index]
        if entry.experiment is not None:
            return entry.experiment
        assert self.load is not None
        return self.load(entry.row.id)

    def __iter__(self) -> Iterator[Experiment]:
        return (self[k] for k in range(len(self)))

    @property
    def keys(self) -> tuple[str, ...]:
        """Full names of the experiments: dataset/name."""
        return tuple(entry.row.key for entry in self.entries)

    def _with(self, entries: Iterable[ExperimentEntry]) -> Experiments:
        return replace(self, entries=tuple(entries))

    def where(self, *filters: str) -> Experiments:
        """Return the experiments that match all terms of a filter.

        Parameters
        ----------
        *filters : str
            Terms separated by spaces: comparisons such as `surface=abs`, `speed_m_s<0.05`,
            `moved>50` [mm], `turned>10` [deg] or `error>5` [mm]; marks such as `real`,
            `simulated`, `flagged` or `clean`; other words occur in the name, a condition, a flag
            or a note. The same filters are understood by commands and pages.

        Raises
        ------
        InvalidInput
            An unknown condition, or an error of experiments that have none.

        Examples
        --------
        >>> import fixel
        >>> pushes = fixel.datasets.example()
        >>> len(pushes.where("surface=plywood turned>20"))
        8
        """
        query = selection.parse_filter(*filters, include_faulty=True)
        kept = [entry for entry in self.entries if selection.holds(query, entry.row, entry.details)]
        known = selection.KnownNames.of((entry.row, entry.details) for entry in self.entries)
        selection.refuse_unknown(query, known, found=bool(kept))
        asked = next((bound.name for bound in query.bounds if bound.name in selection.ERRORS), None)
        if asked and not any(entry.details.error_mm2 is not None for entry in self.entries):
            raise InvalidInput(
                f"filter: {asked.removesuffix('_mm')}",
                found="experiments that were not simulated",
                expected="errors of simulations",
                hint="use fixel.compare(experiments).experiments, or experiments of a project",
            )
        return self._with(kept)

    def sample(self, n: int, seed: int = 0) -> Experiments:
        """Return a random sample without repetitions, in the order of the experiments.

        Parameters
        ----------
        n : int
            Number of experiments.
        seed : int
            Seed of the random number generator.
        """
        whole(n, "n", most=len(self))
        drawn = np.random.default_rng(seed).choice(len(self), n, replace=False)
        return self._with(self.entries[k] for k in sorted(drawn.tolist()))

    def split(
        self, test: int | float, *, by: str | None = None, seed: int = 0
    ) -> tuple[Experiments, Experiments]:
        """Split the experiments at random into two parts, such as for a fit and for its test.

        Parameters
        ----------
        test : int or float
            Size of the second part: a number of experiments, or a share below 1.
        by : str, optional
            Condition whose values stay together in one part; `test` then counts its values.
        seed : int
            Seed of the random number generator.

        Returns
        -------
        train, test : Experiments
            Both in the order of the experiments.
        """
        groups = [*self.groupby(by).values()] if by else [self._with([e]) for e in self.entries]
        is_share = isinstance(test, float | np.floating) and 0.0 < test < 1.0
        wanted: Any = max(1, round(test * len(groups))) if is_share else test
        is_number = isinstance(wanted, int | np.integer) and not isinstance(test, bool)
        if not is_number or not 0 < wanted < len(groups):
            expected = f"a number from 1 to {len(groups) - 1}, or a share below 1.0"
            raise InvalidInput("test", found=quoted(test), expected=expected)
        drawn = np.random.default_rng(seed).choice(len(groups), wanted, replace=False)
        keys = {(e.row.id, e.row.key) for k in drawn.tolist() for e in groups[k].entries}
        chosen = [(e.row.id, e.row.key) in keys for e in self.entries]
        parts = (
            [e for e, own in zip(self.entries, chosen, strict=True) if own is second]
            for second in (False, True)
        )
        train, held_out = map(self._with, parts)
        return train, held_out

    def groupby(self, condition: str) -> dict[str | float | None, Experiments]:
        """Return the experiments for each value of a condition; None for those without it.

        Parameters
        ----------
        condition : str
            Name of a condition, or `dataset`.

        Raises
        ------
        InvalidInput
            No experiment has this condition.
        """
        found: dict[str | float | None, list[ExperimentEntry]] = {}
        for entry in self.entries:
            known = {"dataset": entry.row.dataset, **entry.row.conditions}
            found.setdefault(known.get(condition), []).append(entry)
        if self.entries and found.keys() == {None}:
            names = {name for entry in self.entries for name in entry.row.conditions}
            raise selection.no_experiment_has("condition", condition, (*sorted(names), "dataset"))
        return {value: self._with(entries) for value, entries in found.items()}

    def with_scene(
        self, scene: SceneChoice | str, *, object_name: str | None = None
    ) -> Experiments:
        """Return the experiments with a scene, which the measured poses complete.

        The object starts at its first measured pose, and the pusher follows its measured path.

        Parameters
        ----------
        scene : Scene, path or callable
            Scene, which may be a template whose pusher has no drive; scene file; or function that
            returns a scene for the conditions and the `name` of an experiment.
        object_name : str, optional
            Body of the scene whose motion was measured; required if there are several.

        Raises
        ------
        InvalidInput
            The poses do not fit the scene.
        """
        complete = import_module("fixel.datasets.own_scene").with_scene
        choice = Path(scene) if isinstance(scene, str) else scene
        made, notes = [], dict.fromkeys(self.notes)
        for one in self:
            completed, sentences = complete(one, choice, object_name)
            made.append(completed)
            notes |= dict.fromkeys(sentences[:1])
        return Experiments.of(made, tuple(notes), self.skipped, self.simulations)

    def in_memory(self) -> Experiments:
        """Return the same experiments, all of them read."""
        if self.load is None:
            return self
        entries = (entry._replace(experiment=self[k]) for k, entry in enumerate(self.entries))
        return replace(self, entries=tuple(entries), load=None)

    def save(self, path: str | Path) -> Path:
        """Save the experiments to a file, which `fixel.load` reads."""
        return Result.save(self.in_memory(), path)

    def _summary(self) -> Summary:
        kinds = Counter("real" if entry.row.is_real else "simulated" for entry in self.entries)
        datasets = sorted({entry.row.dataset for entry in self.entries})
        of = f"dataset {datasets[0]!r}" if len(datasets) == 1 else f"{len(datasets)} datasets"
        n_scene = sum(entry.details.has_scene for entry in self.entries)
        kind = next(iter(kinds)) if len(kinds) == 1 else f"{kinds['real']} real"
        heading = f"Experiments: {len(self)} of {of} ({kind}), {n_scene} with scene"
        skipped = [f"skipped {len(self.skipped)}: {self.skipped[0]}"] if self.skipped else []
        more = max(0, len(self) - MAX_LISTED)
        notes = [f"note: {note}" for note in self.notes if note.startswith(("Guess", "Equal"))]
        return Summary(
            heading if self.entries else "Experiments: none",
            [self._listed()] if self.entries else [],
            [*([f"... and {more} more"] if more else []), *skipped, *notes],
            {"source": note} if (note := " ".join(self.notes)) else {},
        )

    def _listed(self) -> Table:
        """Table of the first experiments; all of them would take long."""
        with_error = any(entry.details.error_mm2 is not None for entry in self.entries)
        listed = self.entries[:MAX_LISTED]
        unit, metre = length_unit(max((row.moved_m for row, _, _ in listed), default=0.0))
        rows = [
            (
                *(row.key, row.n_frame, row.duration_s, row.moved_m / metre),
                degrees(row.turned_rad),
                *([_root(details.error_mm2)] if with_error else []),
            )
            for row, details, _ in listed
        ]
        columns = [Column("name"), Column("frames"), Column("duration", "s", ".2f")]
        columns += [Column("moved", unit, ".1f"), Column("turned", "deg", ".1f")]
        columns += [Column("error", "mm", ".2f")] if with_error else []
        return Table(columns, rows)

    def _data(self) -> Table:
        """Facts in SI units, and a column for each condition."""
        conditions = [entry.row.conditions for entry in self.entries]
        names = sorted({name for own in conditions for name in own})
        columns: dict[str, tuple[str, list[Any]]] = {
            name: (unit, [getattr(entry.row, attribute) for entry in self.entries])
            for name, (attribute, unit) in _FACTS.items()
        }
        for label in ("before_mm2", "after_mm2"):
            errors = [_root(getattr(entry.details, label)) for entry in self.entries]
            if any(error is not None for error in errors):
                columns[f"error_{label[:-4]}"] = "mm", errors
        columns |= {name: ("", [own.get(name) for own in conditions]) for name in names}
        return Table(
            [Column(name, unit) for name, (unit, _) in columns.items()],
            zip(*(values for _, values in columns.values()), strict=True),
        )


_FACTS = {
    **{name: (name, "") for name in ("dataset", "name")},
    **{"real": ("is_real", ""), "frames": ("n_frame", ""), "duration": ("duration_s", "s")},
    **{f"{end}_{axis}": (f"{end}_{axis}_m", "m") for end in ("start", "end") for axis in "xy"},
    **{f"{end}_theta": (f"{end}_theta_rad", "rad") for end in ("start", "end")},
    **{"moved": ("moved_m", "m"), "turned": ("turned_rad", "rad")},
    "contacts": ("contact_mode", ""),
}


def _root(square: float | None) -> float | None:
    return None if square is None else square**0.5


def different(experiments: Experiment | Iterable[Experiment]) -> Experiments:
    """Return experiments, checked that those in memory with the same full name are equal."""
    several, known = Experiments.of(experiments), dict[str, Experiment]()
    for one in (entry.experiment for entry in several.entries):
        first = one and known.setdefault(one.key, one)
        if one and first is not one and first != one:
            found, expected = f"two that differ, both named {one.key}", "a name for each"
            hint = "name one with dataclasses.replace(experiment, dataset=...)"
            raise InvalidInput("experiments", found=found, expected=expected, hint=hint)
    return several
