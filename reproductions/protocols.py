"""Protocols of the benchmark: which pushes are used for training, and which are predicted."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.datasets.mit_push import MitPushes, read_mit_pushes
from fixel.errors import InvalidInput
from fixel.io.array_bytes import ResultCache, listed
from fixel.model import wrapped
from fixel.parts.fit import NAMES
from fixel.parts.model import PartModel
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray, IntArray, ProgressCallback
from fixel.workflows.parts import part_model
from reproductions.fitting import (
    Belief,
    FitMember,
    FittedPushes,
    about,
    fit_pushes,
    gap_registration,
    load_beliefs,
    outline_beliefs,
    part_beliefs,
    profile_beliefs,
    registration_beliefs,
    table_beliefs,
    tip_beliefs,
)
from reproductions.pushes import Key, PushGroup, rows_by_key
from reproductions.residual_process import MAX_REACH, REACH
from reproductions.residuals import (
    Split,
    few_of,
    folds,
    inside_ninety,
    learned_ends,
    random_split,
)
from reproductions.result import RunOptions

SHARE: Final = 0.6  # share of the pushes for training, if there are no folds
FEW_PUSHES: Final = 10
# Standard deviations of the loads on the net.
FREE: Final = 1.0
FREEDOMS: Final = (1.5, 0.3, 3.0)
# Maximum number of pushes of each other shape on a surface that teach about a new one.
MAX_OF_OTHERS: Final = 250
QUICK_SHAPES, QUICK_PUSHES, QUICK_ITERATIONS = 3, 60, 4
ITERATIONS: Final = 10

PROTOCOLS: Final[dict[str, str]] = {
    "calibrated": "physics calibrated on other pushes of the same plate and surface",
    "learned": "the same, and a Gaussian process on what it leaves over",
    "averaged": "the mean of two calibrations: loads free, and balanced loads of six numbers",
    "few": f"physics calibrated on {FEW_PUSHES} pushes of the plate and surface",
    "unregistered": "physics calibrated without any registration of tracker to robot",
    "new-shape": "a plate never seen: what other plates have in common",
}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BenchmarkRequest:
    """Request of a benchmark: protocols, splits and effort.

    Parameters
    ----------
    protocols : tuple of str
        Names of protocols out of `PROTOCOLS`.
    seeds : int
        Number of random splits, each with 60 % of every surface, shape and speed for training.
    folds : int
        Number of folds, with each push held out once; 0 for random splits.
    quick : bool
        Use a few plates of one surface, few pushes and few iterations, as a test.
    threads : int, optional
        Number of threads; by default all cores.
    """

    protocols: tuple[str, ...] = tuple(PROTOCOLS)
    seeds: int = 3
    folds: int = 0
    quick: bool = False
    threads: int | None = None

    def __post_init__(self) -> None:
        for name in self.protocols:
            if name not in PROTOCOLS:
                raise InvalidInput(
                    "--protocol", found=repr(name), expected="one of " + ", ".join(PROTOCOLS)
                )
        if self.seeds < 1:
            raise InvalidInput("--seeds", found=self.seeds, expected="1 or more")
        if self.folds and self.folds < 2:
            raise InvalidInput("--folds", found=self.folds, expected="2 or more, or 0")

    @property
    def iterations(self) -> int:
        return QUICK_ITERATIONS if self.quick else ITERATIONS


def calibrated_bench(options: RunOptions, seeds: int = 1) -> BenchmarkData:
    """Create the data for fits of the protocol `calibrated` to a number of random splits."""
    seeds = 1 if options.quick else seeds
    request = BenchmarkRequest(protocols=("calibrated",), seeds=seeds, quick=options.quick)
    pushes = read_mit_pushes(options.folder)
    return BenchmarkData(pushes, request, ResultCache(options.fits), options.progress)


class Piece(NamedTuple):
    """Predictions for the held-out members of one group."""

    group: PushGroup
    repeat: int
    which: IntArray  # indices of the members
    end: FloatArray  # (n, 3) predicted end poses
    fit: Row
    inside: BoolArray | None = None  # (n, 3)


@final
class BenchmarkData:
    """Data, splits and finished fits, shared by all protocols."""

    def __init__(
        self,
        data: MitPushes,
        request: BenchmarkRequest,
        finished: ResultCache,
        progress: ProgressCallback,
    ) -> None:
        self.data, self.request, self.finished = data, request, finished
        self._progress = progress
        rows = rows_by_key(data, data.usable)
        self.rows = _quick(rows) if request.quick else rows
        self.names = data.names
        self._groups: dict[Key, PushGroup] = {}
        self._part_models: dict[str, PartModel] = {}
        self._done, self.total = 0, 0

    def advance(self, what: str) -> None:
        self._done += 1
        self._progress(self._done, self.total, what)

    def group(self, key: Key) -> PushGroup:
        if key not in self._groups:
            self._groups[key] = PushGroup(self.data, key, self.rows[key], self.request.threads)
        return self._groups[key]

    def on_surface(self, key: Key) -> list[Key]:
        """Keys of all plates on the same surface as a given one."""
        return [own for own in self.rows if own[0] == key[0]]

    def part_model_without(self, shape: str) -> PartModel:
        """Return what the other plates teach about a plate, from 250 pushes of each at most."""
        if shape not in self._part_models:
            rng = np.random.default_rng(0)
            experiments = [
                self.data.experiments[row]
                for own, rows in self.rows.items()
                if own[1] != shape
                for row in np.sort(rng.permutation(rows)[:MAX_OF_OTHERS]).tolist()
            ]
            folder = self.finished.folder
            self._part_models[shape] = part_model(
                experiments,
                part="shape",
                surface="surface",
                threads=self.request.threads,
                store=None if folder is None else folder / "parts",
                progress=False,
            )
        return self._part_models[shape]

    def splits(self, key: Key) -> list[Split]:
        speeds = np.round(self.data.speed[self.rows[key]] * 1e3, 6).tolist()
        if self.request.folds:
            return folds(speeds, self.request.folds, 0)
        return [random_split(speeds, SHARE, seed) for seed in range(self.request.seeds)]

    def fitted(
        self,
        name: str,
        key: Key,
        members: Sequence[FitMember],
        beliefs: Sequence[Belief],
    ) -> FittedPushes:
        """Fit parameters, or load a finished fit of that name from the folder."""
        iterations = self.request.iterations

        def compute() -> Row:
            started = clock.perf_counter()
            found = fit_pushes(members, beliefs, iterations=iterations)
            return {
                "names": list(found.names),
                "point": listed(found.point),
                "pushes_simulated": found.evaluations,
                "seconds": round(clock.perf_counter() - started, 3),
            }

        of = [[tuple(b) for b in beliefs], iterations, [_data_of(m) for m in members]]
        finished = self.finished.get(f"{name}_{'_'.join(key)}", of, compute)
        point = np.array(finished["point"], np.float64)
        return FittedPushes(tuple(finished["names"]), point, int(finished["pushes_simulated"]))

    def learned(
        self, name: str, group: PushGroup, split: Split, physics: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Compute `learned_ends` of held-out members, or load those of that name."""
        speed = self.data.speed[group.rows]

        def compute() -> Row:
            end, sd = learned_ends(group, split, physics, speed)
            return {"end": listed(end), "sd": listed(sd)}

        of = ["learned", REACH, MAX_REACH, physics, group.end[split.train], split.train, speed]
        finished = self.finished.get(f"learned_{name}_{'_'.join(group.key)}", of, compute)
        return np.array(finished["end"]), np.array(finished["sd"])


def _data_of(member: FitMember) -> list[Any]:
    """Data of a group that a fit depends on."""
    group, own = member.group, member.train
    measured = (group.start, group.end, group.tip_start, group.tip_end)
    return [group.key, group.shape.outline, *(a[own] for a in measured), dict(member.known)]


def _calibrated(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    for k, split in enumerate(bench.splits(key)):
        group = bench.group(key)
        found = full_fit(bench, group, k, split)
        yield _piece(bench, group, k, split.held_out, found)
        bench.advance(f"calibrated {' '.join(key)}")


def full_beliefs(group: PushGroup, train: IntArray, balanced: bool = False) -> list[Belief]:
    """Priors of all parameters that pushes of one plate on one surface can determine.

    With `balanced` loads, slopes of the table are left out: the balance cancels them.
    """
    shift = gap_registration(group, train).shift
    return [
        *tip_beliefs(),
        *(profile_beliefs() if balanced else load_beliefs(group, FREE)),
        *registration_beliefs(shift, 0.3e-3),
        *outline_beliefs(),
        *(table_beliefs(slope=0.0) if balanced else table_beliefs()),
    ]


def full_fit(
    bench: BenchmarkData, group: PushGroup, repeat: int | str, split: Split, balanced: bool = False
) -> FittedPushes:
    """Calibrate the physics on a split's training pushes."""
    member = FitMember(group, split.train, {})
    beliefs = full_beliefs(group, split.train, balanced)
    name = "balanced" if balanced else "calibrated"
    return bench.fitted(f"{name}_{repeat}", group.key, [member], beliefs)


def _averaged(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    for k, split in enumerate(bench.splits(key)):
        group = bench.group(key)
        found = [full_fit(bench, group, k, split, balanced) for balanced in (False, True)]
        yield _piece(bench, group, k, split.held_out, *found)
        bench.advance(f"averaged {' '.join(key)}")


def _unregistered(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    for k, split in enumerate(bench.splits(key)):
        group = bench.group(key)
        beliefs = [*tip_beliefs(), *load_beliefs(group, FREE), *table_beliefs()]
        member = FitMember(group, split.train, {})
        found = bench.fitted(f"unregistered_{k}", key, [member], beliefs)
        yield _piece(bench, group, k, split.held_out, found)
        bench.advance(f"unregistered {' '.join(key)}")


def _few(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    """Predict from a few pushes of each plate, with common parameters from all plates together.

    With so few pushes, the prior width of the loads matters; the results of three are averaged.
    """
    for k, split in enumerate(bench.splits(key)):
        group = bench.group(key)
        few = {
            own: few_of(bench.splits(own)[k], FEW_PUSHES, k).train for own in bench.on_surface(key)
        }
        shift, common = _in_common(bench, f"few_{k}", key[0], few)
        shift = gap_registration(group, few[key], shift, 0.7e-3).shift
        known = [
            *tip_beliefs(0.02),
            *table_beliefs(bend=0.2, quarter=0.3, slope=0.0),
            *part_beliefs(0.3),
        ]
        shared = [*about(known, common.values), *registration_beliefs(shift, 0.3e-3)]
        member = FitMember(group, few[key], {})
        found = [
            bench.fitted(f"few_{k}_{sd:g}", key, [member], [*load_beliefs(group, sd), *shared])
            for sd in FREEDOMS
        ]
        yield _piece(bench, group, k, split.held_out, *found)
        bench.advance(f"few {' '.join(key)}")


def _in_common(
    bench: BenchmarkData, name: str, surface: str, train: Mapping[Key, IntArray]
) -> tuple[FloatArray, FittedPushes]:
    """Common parameters of plates on a surface: median of their registrations (2,), and a joint
    fit of tip friction and load distribution."""
    members = []
    shifts = []
    for own, some in train.items():
        group = bench.group(own)
        shifts.append(gap_registration(group, some).shift)
        members.append(FitMember(group, some, _shifted(shifts[-1])))
    table = table_beliefs(bend=0.5, quarter=0.3, slope=0.0)
    beliefs = [*tip_beliefs(), *table, *part_beliefs(0.7)]
    found = bench.fitted(name, (surface, "common"), members, beliefs)
    return np.median(shifts, axis=0), found


def _new_shape(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    """Predict a plate from the other plates on all surfaces, as `fixel.part_model` does."""
    if any(own != key for own in bench.on_surface(key)):
        group = bench.group(key)
        model = bench.part_model_without(key[1])
        end = np.full((len(group), 3), np.nan)
        pushes = [bench.data.experiments[row] for row in group.rows.tolist()]
        with_scene = [k for k, own in enumerate(pushes) if own.scene is not None]
        found = model.predict([pushes[k] for k in with_scene])
        end[with_scene] = [tuple(own.pose) for own in found]
        values = model.distribution(*key).mean.tolist()
        fit = {"surface": key[0], "shape": key[1], "split": 0, "pushes_simulated": 0}
        fit["values"] = dict(zip(NAMES, values, strict=True))
        yield Piece(group, 0, np.arange(len(group)), end, fit)
    bench.advance(f"new-shape {' '.join(key)}")


def _shifted(shift: FloatArray) -> dict[str, float]:
    return {"registration_x": float(shift[0]), "registration_y": float(shift[1])}


def _learned(bench: BenchmarkData, key: Key) -> Iterator[Piece]:
    for k, split in enumerate(bench.splits(key)):
        group = bench.group(key)
        found = full_fit(bench, group, k, split)
        physics = found.predict(group, np.arange(len(group)))
        end, sd = bench.learned(str(k), group, split, physics)
        inside = inside_ninety(group, split.held_out, end, sd)
        yield _piece(bench, group, k, split.held_out, found)._replace(end=end, inside=inside)
        bench.advance(f"learned {' '.join(key)}")


def _piece(
    bench: BenchmarkData, group: PushGroup, repeat: int, which: IntArray, *found: FittedPushes
) -> Piece:
    """Predict members with a fit, or with the mean prediction of several fits."""
    fit = {
        "surface": group.key[0],
        "shape": group.key[1],
        "split": repeat,
        "values": found[0].values,
        "pushes_simulated": sum(own.evaluations for own in found),
    }
    start = group.start[which]
    moved = np.stack([own.predict(group, which) - start for own in found])
    moved[..., 2] = wrapped(moved[..., 2])
    return Piece(group, repeat, which, start + moved.mean(axis=0), fit)


def _quick(rows: dict[Key, IntArray]) -> dict[Key, IntArray]:
    surface = next(iter(rows))[0]
    keys = [key for key in rows if key[0] == surface]
    n_key = min(QUICK_SHAPES, len(keys))
    chosen = [keys[k * len(keys) // n_key] for k in range(n_key)]
    return {
        key: rows[key][np.arange(n) * len(rows[key]) // n]
        for key in chosen
        for n in [min(QUICK_PUSHES, len(rows[key]))]
    }


RUN: Final[dict[str, Callable[[BenchmarkData, Key], Iterator[Piece]]]] = {
    "calibrated": _calibrated,
    "learned": _learned,
    "averaged": _averaged,
    "few": _few,
    "unregistered": _unregistered,
    "new-shape": _new_shape,
}
