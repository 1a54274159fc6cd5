"""Searches by other packages: CMA-ES, and mesh adaptive direct search by NOMAD."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import threading
import warnings
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import IO, Annotated, Any, ClassVar, Final, final

import numpy as np

from fixel.calibration.optimiser import (
    AbstractOptimiser,
    Count,
    CountOrZero,
    Feasible,
    GeneratorSearch,
    Moves,
    Search,
    SearchBox,
    Size,
    feasible_points,
)
from fixel.errors import InvalidInput, require
from fixel.model.fields import Value, check_fields, whole
from fixel.typing import FloatArray

_MORE_WORDS = {
    "tolx": "the cloud shrank to the tolerance",
    "tolflatfitness": "all points have the same error",
    "tolfun": "errors in the cloud no longer differ",
    "tolfunhist": "errors no longer change",
    "tolstagnation": "errors no longer decrease",
    "tolxstagnation": "the cloud no longer moves",
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CmaEs(AbstractOptimiser):
    """CMA-ES, for errors that are rough or have several minima, and for more than five unknowns.

    It needs hundreds of evaluations. With a few dozen, or for a smooth error with one minimum,
    `NelderMead` is better.

    Parameters
    ----------
    sigma : float
        Standard deviation of the first population about the start, in scales of the box. If the
        scale is a tenth of the range, 3 covers the box.
    population : int, optional
        Points per iteration; 4 + 3 ln(n) by default.
    tolerance : float
        Size of the population at which the search ends, in scales.
    restarts : int
        Number of restarts from random feasible points, each with twice the population.
    max_evaluations : int
        Number of evaluations after which no new iteration begins.

    Notes
    -----
    The start is evaluated with the first population. Failed points rank behind all others, by
    their distance from the best point, so that a population of failures returns to it.

    Source
    ------
    Hansen & Ostermeier (2001); restarts after Auger & Hansen (2005); the package pycma.
    """

    name: ClassVar[str] = "cma-es"
    sigma: Size = 2.0
    population: Annotated[int | None, Value(partial(whole, least=3))] = None
    tolerance: Size = 1e-4
    restarts: CountOrZero = 0
    max_evaluations: Count = 20_000

    def __post_init__(self) -> None:
        check_fields(self, "CmaEs")

    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        starts = box.start[None]
        if self.restarts:
            more = feasible_points(box, self.restarts, seed, feasible)
            starts = np.concatenate((starts, more))
        rng = np.random.default_rng(seed)
        return GeneratorSearch(box, lambda search: self._clouds(search, starts, rng))

    def _clouds(self, search: Search, starts: FloatArray, rng: np.random.Generator) -> Moves:
        reason = ""
        population = self.population or 4 + int(3 * math.log(search.box.n))
        for k, start in enumerate(starts):
            cloud = self._strategy(search.box, start, population * 2**k, rng)
            reason = yield from self._cloud(search, start, cloud)
            if search.evaluations >= self.max_evaluations:
                break
        return reason

    def _cloud(self, search: Search, start: FloatArray, cloud: Any) -> Moves:
        """Run CMA-ES once, in coordinates relative to its start, in scales."""
        box = search.box
        worst = -math.inf
        first = True
        while not (reason := self._ended(search, cloud)):
            with _quiet():
                places = cloud.ask()
            # The start itself comes first: its coordinates here are zero.
            table = np.array([np.zeros_like(places[0])] * first + places)[:, : box.n]
            points = start + table * box.scale
            errors = yield np.clip(points, box.low, box.high)
            errors = errors[1:] if first else errors
            first = False
            worst = float(np.max(errors, initial=worst, where=np.isfinite(errors)))
            home = (search.best.point - start) / box.scale
            away = np.linalg.norm(np.array(places)[:, : box.n] - home, axis=1)
            with _quiet():
                cloud.tell(places, _ranked(errors, worst, away).tolist())
        return reason

    def _strategy(
        self, box: SearchBox, start: FloatArray, population: int, rng: np.random.Generator
    ) -> Any:
        # The package needs at least two unknowns: add one without effect to a single one.
        spare = max(0, 2 - box.n)
        low = [*((box.low - start) / box.scale).tolist(), *[-10.0] * spare]
        high = [*((box.high - start) / box.scale).tolist(), *[10.0] * spare]
        options = {
            "bounds": [low, high],
            "popsize": population,
            "tolx": self.tolerance,
            "seed": math.nan,  # do not change NumPy's global random numbers
            "randn": lambda *shape: rng.standard_normal(shape),
            "verbose": -10,  # and read no file of signals
            "verb_log": 0,
            "verb_disp": 0,
        }
        with _quiet():
            strategy = import_module("cma").CMAEvolutionStrategy
            return strategy([0.0] * len(low), self.sigma, options)

    def _ended(self, search: Search, cloud: Any) -> str:
        if search.evaluations >= self.max_evaluations:
            return f"{self.max_evaluations} evaluations were made"
        with _quiet():
            stopped = list(cloud.stop())
        return _MORE_WORDS.get(stopped[0], f"CMA-ES stopped: {stopped[0]}") if stopped else ""


def _ranked(errors: FloatArray, worst: float, away: FloatArray) -> FloatArray:
    """Return errors with failures ranked behind the worst; the package does not accept inf."""
    behind = 0.0 if worst == -math.inf else worst
    return np.where(np.isfinite(errors), errors, behind + max(abs(behind), 1.0) * (1.0 + away))


@contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


THINKS_WITHIN: Final = 600.0  # [s] limit for the next points; usually milliseconds
_WORDS = (
    ("frame size", "the frame shrank to {0.threshold:g} of the scale"),
    ("mesh", "the mesh reached the resolution of numbers"),
    ("number of blackbox", "{0.max_evaluations} evaluations were made"),
)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Mads(AbstractOptimiser):
    """MADS: a pattern search with a dense set of directions and models of the error.

    Converges for errors that are not smooth, where `PatternSearch` can stop at a crease, and needs
    few evaluations for smooth errors. It requests one or two points at a time, so it cannot use
    many cores. Needs `pip install "fixel[mads]"` (NOMAD is under the LGPL).

    Parameters
    ----------
    initial_frame : float
        First steps, in scales of the box.
    threshold : float
        Size of the frame at which the search ends, in scales.
    max_evaluations : int
        Maximum number of evaluations.

    Notes
    -----
    NOMAD requests errors by a callback, and stores its state, including random numbers, in global
    variables: two searches in one process would disturb each other. So each runs in a process of
    its own, which ends with the search or when the search is deleted.

    Source
    ------
    Audet & Dennis (2006); Audet et al. (2022), NOMAD 4.
    """

    name: ClassVar[str] = "mads"
    initial_frame: Size = 1.0
    threshold: Size = 1e-6
    max_evaluations: Count = 20_000

    def __post_init__(self) -> None:
        check_fields(self, "Mads")

    def start(self, box: SearchBox, seed: int = 0, feasible: Feasible | None = None) -> Search:
        require("PyNomad", "Mads", extra="mads")
        search = GeneratorSearch(box, lambda _: self._moves(box, seed))
        search.has_iterations = False
        return search

    def _moves(self, box: SearchBox, seed: int) -> Moves:
        """Relay the requests of NOMAD, which has coordinates relative to the start, in scales."""
        nomad = _Nomad(self._problem(box, seed))
        answer = nomad.answer()
        if "points" not in answer:
            found = _in_words(answer.get("ended"), self)
            raise InvalidInput("Mads", found=found, expected="NOMAD to begin")
        while "points" in answer:
            points = box.start + np.array(answer["points"], np.float64) * box.scale
            errors = yield np.clip(points, box.low, box.high)
            nomad.tell([e if math.isfinite(e) else None for e in errors.tolist()])
            answer = nomad.answer()
        nomad.close()
        return _in_words(answer.get("ended"), self)

    def _problem(self, box: SearchBox, seed: int) -> dict[str, Any]:
        """Return the problem in coordinates relative to the start, in scales."""
        return {
            "start": [0.0] * box.n,
            "low": ((box.low - box.start) / box.scale).tolist(),
            "high": ((box.high - box.start) / box.scale).tolist(),
            "options": [
                "BB_OUTPUT_TYPE OBJ",
                "DISPLAY_DEGREE 0",
                f"SEED {seed % 2**31}",
                f"BB_MAX_BLOCK_SIZE {2 * box.n}",
                f"MAX_BB_EVAL {self.max_evaluations}",
                f"INITIAL_FRAME_SIZE * {self.initial_frame!r}",
                f"MIN_FRAME_SIZE * {self.threshold!r}",
            ],
        }


class _Nomad:
    """NOMAD in a process of its own."""

    def __init__(self, problem: dict[str, Any]) -> None:
        child = str(Path(__file__).with_name("mads_child.py"))
        self._process = subprocess.Popen(
            [sys.executable, "-P", child],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
        )
        self.close = weakref.finalize(self, _end, self._process)
        self.tell(problem)

    def tell(self, content: object) -> None:
        stream = _open(self._process.stdin)
        with contextlib.suppress(OSError):  # it died: `answer` reports that
            stream.write(json.dumps(content) + "\n")
            stream.flush()

    def answer(self) -> dict[str, Any]:
        """Return its next request; empty if it died, or was killed because it hung."""
        hung = threading.Timer(THINKS_WITHIN, self._process.kill)
        hung.start()
        try:
            line = _open(self._process.stdout).readline()
        finally:
            hung.cancel()
        return dict(json.loads(line)) if line.endswith("\n") else {}


def _end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    _open(process.stdout).close()
    with contextlib.suppress(OSError):  # unread input
        _open(process.stdin).close()


def _open(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def _in_words(ended: str | None, options: Mads) -> str:
    if ended is None:
        return "NOMAD ended without an answer"
    for part, words in _WORDS:
        if part in ended.lower():
            return words.format(options)
    return f"NOMAD ended: {ended.strip()}"
