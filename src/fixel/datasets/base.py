"""What the importers share: the plan of an import, guards against bad files, and common parts."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.raw.base import CsvRows
from fixel.errors import DatasetMissing, FixelError, InvalidInput
from fixel.model import Experiment, Flag, Provenance, Scene
from fixel.typing import BoolArray, FloatArray

# Numbers beyond this are no readings, not even microseconds since 1970; their squares stay far
# inside float64.
LARGEST_NUMBER: Final = 1e18

# What a reader trips over when a file holds something else than its format says.
_TRIPPED = (
    ArithmeticError,
    AttributeError,
    LookupError,
    OSError,
    RecursionError,
    TypeError,
    ValueError,
)


@final
@dataclass(frozen=True)
class ImportPlan:
    """What would be imported: nothing is built until asked for.

    Parameters
    ----------
    importer : str
        Its name.
    source : Path
        File or folder.
    understood : tuple of str
        How the source was read, a sentence each: rows, rates, units, frames, quirks, guesses.
    n_experiments : int
    make : callable
        Builds the experiments, one at a time.
    """

    importer: str
    source: Path
    understood: tuple[str, ...]
    n_experiments: int
    make: Callable[[], Iterator[Experiment]] = field(repr=False, compare=False)

    def experiments(self) -> Iterator[Experiment]:
        """The experiments, one at a time.

        Raises
        ------
        InvalidInput
            A record that cannot be one; those before it have been handed out.
        """
        making = self.make()
        while True:
            # Around each step and not around the loop: what the caller does in between is its own.
            with guarded(self.source.name):
                experiment = next(making, None)
            if experiment is None:
                return
            yield experiment


class Importer(ABC):
    """Turns one kind of recorded data into experiments."""

    name: ClassVar[str]
    title: ClassVar[str]
    licence: ClassVar[str]
    citation: ClassVar[str]
    options: ClassVar[Mapping[str, str]] = {}  # name and what it is for

    @abstractmethod
    def recognised(self, source: Path) -> bool:
        """Whether a file or folder looks like this kind; nothing is read but names."""

    @abstractmethod
    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        """Read what is needed to say what is there."""

    def read(self, source: Path, **options: object) -> ImportPlan:
        """Read a file or folder.

        Raises
        ------
        DatasetMissing
            Files are not there.
        InvalidInput
            An option there is not, or a file that does not hold what it should.
        """
        source = Path(source)
        for option in options:
            if option not in self.options:
                known = ", ".join(self.options) or "none"
                raise InvalidInput(
                    f"importer {self.name}",
                    found=f"the option {option}",
                    expected=f"one of those it has: {known}",
                )
        if not source.exists():
            raise DatasetMissing(source, f"data for {self.name}", "there is no such file or folder")
        with guarded(source.name):
            return self._plan(source, options)


@contextmanager
def guarded(source: str) -> Iterator[None]:
    """Turn whatever a hostile file makes a reader trip over into one clear refusal.

    The readers check what they expect; this is for what nobody expected, such as a text where a
    JSON file has always had a number.
    """
    try:
        with np.errstate(invalid="raise", over="raise", divide="raise"):
            yield
    except FixelError:
        raise
    except _TRIPPED as problem:
        raise InvalidInput(
            source,
            found=f"{type(problem).__name__}: {problem}"[:200],
            expected="data in the form this importer knows",
        ) from problem


def remark(name: str, detail: str = "") -> Flag:
    """Something worth knowing that does not keep an experiment from being used."""
    return Flag(name, detail, fault=False)


class Origin:
    """Provenance of what is read from files: each is summed up once."""

    def __init__(self) -> None:
        self._known: dict[Path, Provenance] = {}

    def of(self, path: Path) -> Provenance:
        """Which file, with its checksum, and which fixel read it."""
        if path not in self._known:
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            self._known[path] = Provenance(version=_version(), source=path.name, sha256=digest)
        return self._known[path]


def _version() -> str:
    try:
        return version("fixel")
    except PackageNotFoundError:  # run from a folder that was never installed
        return "unknown"


def scene_or_flag(build: Callable[[], Scene]) -> tuple[Scene | None, tuple[Flag, ...]]:
    """A scene, or none and why: what was measured is worth keeping without one."""
    try:
        return build(), ()
    except InvalidInput as problem:
        return None, (remark("no-scene", str(problem)),)


def whole_numbers(table: CsvRows, column: str, largest: int = 2**31) -> NDArray[np.int64]:
    """(n,) one column as whole numbers of at least 0."""
    numbers = table.numbers(column)
    wrong = (numbers < 0.0) | (numbers > largest) | (numbers != np.round(numbers))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InvalidInput(
            f"{table.source}, row {row + 1}, column {column}",
            found=float(numbers[row]),
            expected=f"a whole number from 0 to {largest}",
        )
    return numbers.astype(np.int64)


def refuse_giants(table: CsvRows, *columns: str) -> None:
    """Refuse numbers that no rig measures, before their squares overflow."""
    for column in columns:
        numbers = np.abs(table.numbers(column, blank=True))
        if (numbers > LARGEST_NUMBER).any():
            row = int(np.nanargmax(numbers))
            raise InvalidInput(
                f"{table.source}, row {row + 1}, column {column}",
                found=table.columns[column][row],
                expected=f"a number within {LARGEST_NUMBER:g}",
            )


def refuse_repeated(names: Iterable[str], source: str, column: str) -> None:
    """Refuse a table with two experiments of one name."""
    seen: set[str] = set()
    for row, name in enumerate(names):
        if name in seen:
            raise InvalidInput(
                f"{source}, row {row + 1}, column {column}",
                found=f"{name!r} again",
                expected="every name once",
            )
        seen.add(name)


def rows_of(names: NDArray[np.str_]) -> dict[str, NDArray[np.intp]]:
    """Row numbers of each name, in the order they stand in."""
    order = np.argsort(names, kind="stable")
    found, first = np.unique(names[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, first[1:]), strict=True))


def advancing(time: FloatArray) -> BoolArray:
    """(n,) which instants lie after all those before."""
    latest = np.maximum.accumulate(time)
    return np.append(True, time[1:] > latest[:-1])[: len(time)]


def rate_of(time: FloatArray) -> float:
    """Readings a second [1/s], from the median interval; 0 for fewer than two."""
    steps = np.diff(time)
    typical = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / typical if typical > 0.0 else 0.0
