"""Base of the importers: the plan of an import, and protection from bad files."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import ClassVar, final

import numpy as np

from fixel.datasets.files import Problems
from fixel.errors import DatasetMissing, FixelError, InvalidInput
from fixel.io.atomic import INVALID_CONTENT
from fixel.model import Experiment, Flag, Provenance, Scene, Trajectory
from fixel.model.records import SimulationRecord
from fixel.typing import FloatArray

# Exceptions that a reader may raise on a file that violates its format.
_TRIPPED = (*INVALID_CONTENT, OSError)


@final
@dataclass(frozen=True)
class ImportPlan:
    """Plan of an import; experiments are built lazily.

    Without a sound experiment, it raises the first problem.
    """

    importer: str  # name of the importer
    source: Path  # file or folder to import
    # Sentences about how the source was interpreted: rows, rates, units, frames, quirks, guesses.
    understood: tuple[str, ...]
    names: Sequence[str]  # names of the experiments that are built: dataset/name
    # Builds the experiment at a position of `names`.
    build: Callable[[int], Experiment] = field(repr=False, compare=False)
    # Error of each experiment or file that is left out, by its name; building the experiments adds
    # those that cannot be built.
    problems: Problems = field(default_factory=dict, repr=False)
    # Returns the simulation that the publisher of the data made of an experiment, or None, from the
    # position and the experiment.
    simulate: Callable[[int, Experiment], SimulationRecord | None] | None = None
    # Those by the publisher, for the experiments built so far.
    simulations: dict[str, SimulationRecord] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if not self.names:
            raise next(iter(self.problems.values()))

    @property
    def n_experiments(self) -> int:
        """Number of experiments to build."""
        return len(self.names)

    @property
    def skipped(self) -> tuple[str, ...]:
        """Experiments and files that are left out, with the reason."""
        return tuple(f"{name}: {problem}" for name, problem in self.problems.items())

    def __len__(self) -> int:
        return self.n_experiments

    def __iter__(self) -> Iterator[Experiment]:
        return self.experiments()

    def experiments(self) -> Iterator[Experiment]:
        """Yield the experiments, built one at a time; invalid ones are added to `problems`.

        If none can be built, raise the error of the first.
        """
        first: FixelError | None = None
        sound = False
        for k, name in enumerate(self.names):
            # Guard each step, not the whole loop: errors of the caller in between must pass.
            try:
                with guarded(self.source.name):
                    experiment = self.build(k)
            except FixelError as problem:
                first = first or problem
                self.problems[name] = problem
                continue
            with collected(self.problems, f"simulation of {experiment.key}", self.source.name):
                found = self.simulate(k, experiment) if self.simulate else None
                if found is not None:
                    self.simulations[experiment.key] = found
            sound = True
            yield experiment
        if first is not None and not sound:
            raise first


def named(dataset: str, problems: Problems) -> Problems:
    """Return problems of the experiments of a dataset under the full names of the experiments."""
    return {f"{dataset}/{name}": problem for name, problem in problems.items()}


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

    def check_options(self, options: Iterable[str]) -> None:
        """Raise `InvalidInput` for an option that the importer does not have."""
        for option in options:
            if option not in self.options:
                known = ", ".join(self.options) or "none"
                found, expected = f"the option {option}", f"one of its options: {known}"
                raise InvalidInput(f"importer {self.name}", found=found, expected=expected)

    def read(self, source: Path, **options: object) -> ImportPlan:
        """Read a file or folder and plan its import.

        Missing files raise `DatasetMissing`; an unknown option or invalid content raises
        `InvalidInput`.
        """
        source = Path(source)
        self.check_options(options)
        if not source.exists():
            raise DatasetMissing(source)
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
            source, found=problem, expected="data in the format of this importer"
        ) from problem


@contextmanager
def collected(problems: Problems, name: str, source: str) -> Iterator[None]:
    """Add an error of the block to problems, unless one of this name is known; see `guarded`."""
    try:
        with guarded(source):
            yield
    except FixelError as problem:
        problems.setdefault(name, problem)


def trajectory_of(time: FloatArray, pose: FloatArray) -> Trajectory:
    """Create a trajectory of poses (n, 3), with unwrapped angles."""
    return Trajectory(time=time, pose=np.column_stack((pose[:, :2], np.unwrap(pose[:, 2]))))


def remark(name: str, detail: str = "") -> Flag:
    """Create a flag that informs but does not exclude an experiment from use."""
    return Flag(name, detail, fault=False)


def origin_of(path: Path) -> Provenance:
    """Provenance of an imported file: its name and checksum, and the version of fixel."""
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return Provenance(version=version("fixel"), source=path.name, sha256=digest)


def scene_or_flag(build: Callable[[], Scene]) -> tuple[Scene | None, tuple[Flag, ...]]:
    """Build a scene; on error return None and a flag, since measurements are useful without it."""
    try:
        return build(), ()
    except InvalidInput as problem:
        return None, (remark("no-scene", str(problem)),)
