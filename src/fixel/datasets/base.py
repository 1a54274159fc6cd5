"""Base of the importers: the plan of an import, protection from bad files, and common functions."""

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

# Larger numbers cannot be readings, not even microseconds since 1970. Squares of smaller ones stay
# far inside float64.
LARGEST_NUMBER: Final = 1e18

# Exceptions that a reader may raise on a file that violates its format.
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
    """Plan of an import; experiments are built lazily.

    Parameters
    ----------
    importer : str
        Name of the importer.
    source : Path
        File or folder to import.
    understood : tuple of str
        How the source was interpreted: rows, rates, units, frames, quirks, guesses; sentences.
    n_experiments : int
    make : callable
        Function that yields the experiments, built one at a time.
    """

    importer: str
    source: Path
    understood: tuple[str, ...]
    n_experiments: int
    make: Callable[[], Iterator[Experiment]] = field(repr=False, compare=False)

    def experiments(self) -> Iterator[Experiment]:
        """Yield the experiments, built one at a time.

        Raises
        ------
        InvalidInput
            An invalid record; those before it have been yielded.
        """
        making = self.make()
        while True:
            # Guard each step, not the whole loop: errors of the caller in between must pass.
            with guarded(self.source.name):
                experiment = next(making, None)
            if experiment is None:
                return
            yield experiment


class Importer(ABC):
    """Base class of importers, which convert one kind of recorded data to experiments."""

    name: ClassVar[str]
    title: ClassVar[str]
    licence: ClassVar[str]
    citation: ClassVar[str]
    options: ClassVar[Mapping[str, str]] = {}  # name -> purpose

    @abstractmethod
    def recognised(self, source: Path) -> bool:
        """Whether a file or folder is of this kind, judged by file names only."""

    @abstractmethod
    def _plan(self, source: Path, options: Mapping[str, object]) -> ImportPlan:
        """Read enough of the source to plan its import."""

    def read(self, source: Path, **options: object) -> ImportPlan:
        """Read a file or folder and plan its import.

        Raises
        ------
        DatasetMissing
            Files are missing.
        InvalidInput
            An unknown option, or a file with invalid content.
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
    """Raise `InvalidInput` for any exception that a malformed file causes in a reader.

    The readers check expected errors; this is for unexpected ones, such as a text where a JSON file
    has always had a number.
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
    """Create a flag that informs but does not exclude an experiment from use."""
    return Flag(name, detail, fault=False)


class Origin:
    """Provenance of imported files; the checksum of each is computed once."""

    def __init__(self) -> None:
        self._known: dict[Path, Provenance] = {}

    def of(self, path: Path) -> Provenance:
        """Provenance of a file: its name and checksum, and the version of fixel."""
        if path not in self._known:
            with path.open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            self._known[path] = Provenance(version=_version(), source=path.name, sha256=digest)
        return self._known[path]


def _version() -> str:
    try:
        return version("fixel")
    except PackageNotFoundError:  # run from a source folder that was never installed
        return "unknown"


def scene_or_flag(build: Callable[[], Scene]) -> tuple[Scene | None, tuple[Flag, ...]]:
    """Build a scene; on error return None and a flag, since measurements are useful without it."""
    try:
        return build(), ()
    except InvalidInput as problem:
        return None, (remark("no-scene", str(problem)),)


def whole_numbers(table: CsvRows, column: str, largest: int = 2**31) -> NDArray[np.int64]:
    """Return one column as whole numbers (n,) from 0 to `largest`; raise for others."""
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
    """Raise `InvalidInput` for absurdly large numbers, before their squares overflow."""
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
    """Raise `InvalidInput` if a name of an experiment is repeated."""
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
    """Row numbers of each name, in the order of the table."""
    order = np.argsort(names, kind="stable")
    found, first = np.unique(names[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, first[1:]), strict=True))


def advancing(time: FloatArray) -> BoolArray:
    """Mask (n,) of the times that are later than all previous ones."""
    latest = np.maximum.accumulate(time)
    return np.append(True, time[1:] > latest[:-1])[: len(time)]


def rate_of(time: FloatArray) -> float:
    """Readings per second [1/s], from the median interval; 0 for fewer than two."""
    steps = np.diff(time)
    typical = float(np.median(steps)) if len(steps) else 0.0
    return 1.0 / typical if typical > 0.0 else 0.0
