"""Other simulators on real pushes of MIT and CMU, before and after calibration.

Every engine simulates the same scenes: the object on the same support points, the tip on a rigid
drive at its real speed. Every group is calibrated on the same few pushes, with the same parameters,
start, priors and search. Held-out pushes have the outcome. A group is a plate on a surface (MIT),
calibrated on its own pushes, or a support on a surface (CMU), calibrated on the pushes of other
supports on the other surface.

The settings below were chosen on training pushes of fixel alone, before an engine simulated a
held-out push.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.optimiser import SearchBox
from fixel.datasets.cmu import MU_FINGER
from fixel.datasets.contact import pushed_scene
from fixel.datasets.mit_push import NOMINAL, STROKE, read_mit_pushes
from fixel.datasets.mit_push_records import TIP
from fixel.errors import DatasetMissing
from fixel.io.array_bytes import ResultCache, listed
from fixel.model import Body, Disk, SupportPoints, UniformPressure, wrapped
from fixel.model.parameters import ENGINE_PARAMETERS
from fixel.model.support import support_grid
from fixel.replay.base import Row, errors_in_mm_and_deg
from fixel.simulation.motion import motion_model, stated_name
from fixel.simulation.pack import pusher_path
from fixel.simulation.rollouts import RolloutCase, ensemble_of
from fixel.typing import BoolArray, FloatArray, IntArray
from reproductions.charts.engines import engines_figure
from reproductions.fitting import (
    ARM,
    LOST,
    NOISE,
    WIDTH,
    Belief,
    about,
    outline_beliefs,
    profile_beliefs,
    registration_beliefs,
    table_beliefs,
    tip_beliefs,
)
from reproductions.protocols import SHARE
from reproductions.pushes import Key, rows_by_key
from reproductions.registration import registration_from_gaps
from reproductions.residuals import Split, few_of, random_split
from reproductions.result import Reproduction, RunOptions
from reproductions.tripod_pushes import read_pushes, support_of

# Budgets, the same for all engines: set by the time of the slowest.
TRAIN: Final = 4  # pushes of every plate and surface that calibrate
CMU_SPEED: Final = 2.5e-3  # of the finger [m/s]
CMU_TRAIN: Final = 6  # pushes that calibrate for a support and surface of CMU
HELD_OUT: Final = 12  # pushes of every plate and surface that are scored, at most
CMU_HELD_OUT: Final = 8  # of every support and surface
ITERATIONS: Final = 2  # of the search
QUICK: Final = 4  # pushes of two plates, and one iteration
# Box2D refuses the outline of ellip2 with 128 corners, and Drake takes 6 s for each of its pushes.
# Plywood is the other surface of the same plates: one fits into the time of the slowest engine.
LEFT_OUT: Final = frozenset({"ellip2", "plywood"})
GOOD_MM: Final = 5.0
RESAMPLES: Final = 10_000

# Priors of the parameters that all engines have. The recorded path was already shifted by the gaps
# at the ends of the training pushes, without physics.
SHARED: Final = (
    *about(tip_beliefs(), {"mu_pusher": NOMINAL["mu_pusher"]}),
    *profile_beliefs(),
    *table_beliefs(slope=0.0),
    *registration_beliefs(np.zeros(2), 0.3e-3),
)
SPREAD: Final = float(np.log(3.0))  # standard deviation of the logarithm of an own parameter
MIN_OWN: Final = 1e-9  # least value of an own parameter, whose logarithm is searched
# For CMU, whose support points are known: friction and radius of the finger, which are not.
CMU_SHARED: Final = (Belief("mu_pusher", MU_FINGER, 0.2, 0.02, 1.0), outline_beliefs()[3])


class Setting(NamedTuple):
    """Engine as it takes part, and its own parameters to calibrate."""

    motion: str
    own: tuple[str, ...] = ()


SETTINGS: Final[Mapping[str, Setting]] = {
    "fixel": Setting("quasistatic"),
    "fixel dynamic": Setting("dynamic"),
    "Box2D": Setting("box2d", ("inertia_factor",)),
    "pymunk": Setting("pymunk", ("inertia_factor", "slop")),
    "MuJoCo": Setting("mujoco", ("timeconst", "width", "impratio")),
    "Drake": Setting("drake:step=0.01", ("stiffness", "dissipation")),
}
BASELINE: Final = "fixel"
SHIPPED, CALIBRATED, OWN = "as shipped", "calibrated", "with own parameters"
CONDITIONS: Final = (SHIPPED, CALIBRATED, OWN)
STILL: Final = "object does not move"


class Member(NamedTuple):
    """Pushes of one group, by their places in the list of cases."""

    key: Key  # surface, plate or support
    train: IntArray  # registered
    held_out: IntArray  # as recorded
    registered: IntArray  # the same pushes, registered


class Cases(NamedTuple):
    """Pushes that engines simulate, with the recorded outcomes."""

    members: tuple[Member, ...]
    cases: tuple[RolloutCase, ...]
    start: FloatArray  # (n, 3)
    end: FloatArray  # (n, 3) measured
    speed: FloatArray  # (n,)
    shared: tuple[Belief, ...]  # priors of the parameters that all engines have


class Pushes(NamedTuple):
    """Recorded straight pushes."""

    bodies: Sequence[Body]  # (n,) on support points
    tip: Disk
    start: FloatArray  # (n, 3)
    end: FloatArray  # (n, 3)
    tip_start: FloatArray  # (n, 2)
    tip_end: FloatArray  # (n, 2)
    duration: FloatArray  # (n,)
    speed: FloatArray  # (n,) nominal


class Part(NamedTuple):
    """Dataset that engines are compared on."""

    folder: str
    select: Callable[[Path, bool], Cases]


class Ends(NamedTuple):
    """Simulated end poses."""

    pose: FloatArray  # (n, 3)
    good: BoolArray  # (n,)


def run(options: RunOptions) -> Reproduction:
    """Compare engines on held-out pushes, as shipped and calibrated.

    It compares them on the datasets that the folder has. With `quick`, it uses two groups, few
    pushes and no Drake.
    """
    root = options.folder
    folders = {
        name: root if root.name == part.folder else root / part.folder
        for name, part in parts().items()
    }
    chosen = {name: part for name, part in parts().items() if folders[name].is_dir()}
    if not chosen:
        raise DatasetMissing(root, " or ".join(part.folder for part in parts().values()))
    overall: list[Row] = []
    groups: list[Row] = []
    about: Row = {"quick": options.quick}
    settings = {k: v for k, v in SETTINGS.items() if not options.quick or k != "Drake"}
    for data, part in chosen.items():
        cases, found = part.select(folders[data], options.quick), {}
        for k, (name, setting) in enumerate(settings.items()):
            options.progress(k, len(settings), f"{data}, {name}")
            found[name] = _of_engine(setting, cases, ResultCache(options.fits), options)
        scores = _scores(cases, found)
        overall += [{"data": data, **_overall(key, scores, found)} for key in scores]
        for key, own in scores.items():
            groups += [{"data": data, **row} for row in _groups(cases, key, own)]
        about[data] = {
            name: {**own._asdict(), "engine": found[name]["engine"]}
            for name, own in settings.items()
        }
    return Reproduction(
        tables={"overall": overall, "groups": groups},
        conclusions=[_conclusion(row) for row in overall],
        settings=about,
        figure=partial(engines_figure, [row for row in groups if row["data"] == groups[0]["data"]]),
    )


def parts() -> dict[str, Part]:
    """Return the datasets by name."""
    return {
        "MIT": Part("mit_push_endpoints", mit_cases),
        "CMU": Part("cmu_tripod_push", cmu_cases),
    }


# --- pushes -----------------------------------------------------------------------------------


def mit_cases(folder: Path, quick: bool) -> Cases:
    """Select the pushes of every plate and surface, of the first split of the benchmark."""
    data = read_mit_pushes(folder)
    bodies = {name: _on_points(body) for name, body in data.bodies.items()}
    pushes = Pushes(
        [bodies[name] for name in data.shape.tolist()],
        TIP,
        *(data.start, data.end, data.tip_start, data.tip_end),
        *(STROKE / data.speed, data.speed),
    )
    splits: dict[Key, Split] = {}
    for key, own in rows_by_key(data, data.usable).items():
        if not LEFT_OUT.isdisjoint(key) or (quick and len(splits) == 2):
            continue
        split = random_split(np.round(data.speed[own] * 1e3, 6).tolist(), SHARE, 0)
        train = own[few_of(split, QUICK if quick else TRAIN, 0).train]
        splits[key] = Split(train, own[_spread(split.held_out, QUICK if quick else HELD_OUT)])
    return cases_of(pushes, splits, SHARED, friction=NOMINAL["mu_pusher"], by_gaps=True)


def cmu_cases(folder: Path, quick: bool) -> Cases:
    """Select the pushes of every support and surface of CMU.

    Odd pushes of each are held out. Even ones train, for the other supports on the other surface.
    """
    found = read_pushes(folder)
    scenes = [push.target.case.scene for push in found]
    path = np.array([pusher_path(scene.pushers[0], scene.duration)[[0, -1]] for scene in scenes])
    tip = scenes[0].pushers[0].shape
    assert isinstance(tip, Disk)
    pushes = Pushes(
        [_on_points(scene.bodies[0]) for scene in scenes],
        tip,
        np.array([scene.bodies[0].pose for scene in scenes]),
        np.array([push.target.pose[-1] for push in found]),
        *(path[:, 0, 1:3], path[:, 1, 1:3], path[:, 1, 0], np.full(len(path), CMU_SPEED)),
    )
    groups: dict[Key, list[int]] = {}
    for row, push in enumerate(found):
        key = str(push.target.conditions["surface"]), support_of(push)
        groups.setdefault(key, []).append(row)
    n, scored = (QUICK, QUICK) if quick else (CMU_TRAIN, CMU_HELD_OUT)
    splits = {}
    for key in sorted(groups)[: 2 if quick else None]:
        others = [groups[k][::2] for k in groups if k[0] != key[0] and k[1] != key[1]]
        train = np.random.default_rng(0).permutation(np.concatenate(others))[:n]
        splits[key] = Split(train, _spread(np.array(groups[key][1::2]), scored))
    return cases_of(pushes, splits, CMU_SHARED, friction=MU_FINGER, by_gaps=False)


def _on_points(body: Body) -> Body:
    """Return a body on support points; even pressure becomes that of the points for all engines."""
    if isinstance(body.support, SupportPoints):
        return body
    assert isinstance(body.support, UniformPressure)
    points = support_grid(body.shape)[0]
    return replace(body, support=SupportPoints(points=points, friction=body.support.friction))


def cases_of(
    pushes: Pushes,
    splits: Mapping[Key, Split],
    shared: tuple[Belief, ...],
    *,
    friction: float,
    by_gaps: bool,
) -> Cases:
    """Build the scenes of all groups; `by_gaps` shifts paths by the gaps at the ends of training
    pushes before a calibration."""
    members: list[Member] = []
    chosen: list[RolloutCase] = []
    rows: list[int] = []
    for key, (train, held_out) in splits.items():
        shape, shift = pushes.bodies[train[0]].shape, np.zeros(2)
        if by_gaps:
            ends = pushes.end[train], pushes.tip_end[train]
            shift = registration_from_gaps(shape, pushes.tip.radius, *ends).shift
        places = []
        for some, by in ((train, shift), (held_out, np.zeros(2)), (held_out, shift)):
            places.append(len(rows) + np.arange(len(some)))
            chosen += [_case(pushes, row, by, friction) for row in some.tolist()]
            rows += some.tolist()
        members.append(Member(key, *places))
    start, end, speed = (column[rows] for column in (pushes.start, pushes.end, pushes.speed))
    return Cases(tuple(members), tuple(chosen), start, end, speed, shared)


def _spread(rows: IntArray, most: int) -> IntArray:
    n = min(most, len(rows))
    return rows[np.arange(n) * len(rows) // n]


def _case(pushes: Pushes, row: int, shift: FloatArray, friction: float) -> RolloutCase:
    """Scene of a push at its real speed, with the tip moved by a shift and out of the object."""
    path = np.zeros((2, 4))
    path[1, 0] = pushes.duration[row]
    path[0, 1:3], path[1, 1:3] = pushes.tip_start[row] + shift, pushes.tip_end[row] + shift
    body = replace(pushes.bodies[row], pose=pushes.start[row])
    scene, flags = pushed_scene(body, pushes.tip, path, friction=friction)
    assert scene is not None, flags
    return RolloutCase(scene, path[1:, 0])


# --- one engine -------------------------------------------------------------------------------


def _of_engine(
    setting: Setting, cases: Cases, cache: ResultCache, options: RunOptions
) -> dict[str, Any]:
    """Results of an engine by condition, for each member; from the cache where they are there.

    Its processes are started only where something is missing.
    """
    stated = stated_name(setting.motion)
    engine = _Engine(cases, setting)
    own = own_beliefs(setting)
    found: dict[str, Any] = {"engine": stated}
    values: dict[Key, dict[str, float]] = {member.key: {} for member in cases.members}
    for condition, beliefs in (
        (SHIPPED, ()),
        (CALIBRATED, cases.shared),
        (OWN, (cases.shared[0], *own)),
    ):
        if condition == OWN and not own:
            continue
        iterations = 1 if options.quick else ITERATIONS
        found[condition] = []
        for member in cases.members:
            known = values[member.key]
            of = [stated, list(beliefs), iterations, _data_of(cases, member), known]
            label = "_".join((setting.motion.partition(":")[0], condition, *member.key))
            compute = partial(_of_member, engine, member, beliefs, iterations, known)
            part = cache.get(label.replace(" ", "_"), of, compute)
            values[member.key] = part["values"]
            found[condition].append(part)
    return found


def _of_member(
    engine: _Engine,
    member: Member,
    beliefs: Sequence[Belief],
    iterations: int,
    known: Mapping[str, float],
) -> Row:
    """Calibrate for one group, and simulate its held-out pushes."""
    begun = clock.perf_counter()
    values, simulations = engine.calibrated(member, beliefs, iterations, known)
    seconds = clock.perf_counter() - begun
    begun = clock.perf_counter()
    ends = engine.ends(member.registered if beliefs else member.held_out, values)
    return {
        "values": values,
        "simulations": simulations,
        "seconds": round(seconds, 3) if beliefs else 0.0,
        "held_out_seconds": round(clock.perf_counter() - begun, 3),
        "end": listed(ends.pose),
        "good": ends.good.tolist(),
    }


class _Engine:
    """Engine with all cases, started when the first of them is simulated."""

    def __init__(self, cases: Cases, setting: Setting) -> None:
        self.cases, self.setting = cases, setting
        self._made: Any = None

    def simulate(self, which: IntArray, values: Mapping[str, FloatArray]) -> Ends:
        if self._made is None:
            self._made = ensemble_of(self.cases.cases, motion_model(self.setting.motion))
        outcome = self._made.simulate(which, values)
        return Ends(outcome.pose[:, -1], outcome.converged)

    def ends(self, which: IntArray, values: Mapping[str, float]) -> Ends:
        """Simulate pushes with equal values; those that fail do not move."""
        found = self.simulate(which, {name: np.full(len(which), v) for name, v in values.items()})
        return found._replace(
            pose=np.where(found.good[:, None], found.pose, self.cases.start[which])
        )

    def calibrated(
        self,
        member: Member,
        beliefs: Sequence[Belief],
        iterations: int,
        known: Mapping[str, float],
    ) -> tuple[dict[str, float], int]:
        """Fit parameters to the training pushes, others as known; values, and simulations."""
        if not beliefs:
            return {}, 0
        mean, sd, low, high = (np.array([b[k] for b in beliefs]) for k in (1, 2, 3, 4))
        start = [_searched(b.name, known[b.name]) if b.name in known else b.mean for b in beliefs]
        box = SearchBox(low, high, np.clip(np.array(start), low, high), sd)
        method = LeastSquares(
            loss="soft_l1",
            width=WIDTH / NOISE,
            differences="one-sided",
            difference=0.15,
            trials=2,
            tolerance=1e-3,
            most_iterations=iterations,
            secant=True,
        )
        train, count = member.train, 0

        def fixed(n: int) -> dict[str, FloatArray]:
            return {name: np.full(n, value) for name, value in known.items()}

        def residuals(points: FloatArray) -> FloatArray:
            nonlocal count
            k, n = len(points), len(train)
            count += k * n
            columns = {b.name: np.repeat(points[:, j], n) for j, b in enumerate(beliefs)}
            found = self.simulate(np.tile(train, k), fixed(k * n) | _plain(columns))
            away = found.pose.reshape(k, n, 3) - self.cases.end[train]
            away[..., 2] = ARM * wrapped(away[..., 2])
            away[~found.good.reshape(k, n)] = LOST
            return np.asarray(away.reshape(k, 3 * n) / NOISE)

        best = fit(method.start(box, prior=NormalPrior(mean=mean, sd=sd)), residuals)
        columns = {b.name: best.point[j] for j, b in enumerate(beliefs)}
        return {**known, **{name: float(v) for name, v in _plain(columns).items()}}, count


def own_beliefs(setting: Setting) -> tuple[Belief, ...]:
    """Return the priors of an engine's own parameters, of their logarithms.

    They are about the values as shipped, within the usual ranges.
    """
    found = []
    for name in setting.own:
        engine = setting.motion.partition(":")[0]
        usual = ENGINE_PARAMETERS[engine][name].usual
        assert usual is not None
        low, shipped, high = np.log(np.maximum(usual, MIN_OWN))
        found.append(Belief(f"{engine}.{name}", float(shipped), SPREAD, float(low), float(high)))
    return tuple(found)


def _searched(name: str, value: float) -> float:
    return float(np.log(value)) if "." in name else value


def _plain(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Values of parameters from those of the search: an engine's own are logarithms there."""
    return {name: np.exp(x) if "." in name else x for name, x in columns.items()}


# --- scores -----------------------------------------------------------------------------------


class Scores(NamedTuple):
    """Errors of one engine in one condition on all held-out pushes, in the order of the members."""

    mm: FloatArray  # (n,)
    deg: FloatArray  # (n,)
    good: BoolArray  # (n,)
    group: IntArray  # (n,) index of the member


def _scores(cases: Cases, found: Mapping[str, Any]) -> dict[tuple[str, str], Scores]:
    held_out = np.concatenate([member.held_out for member in cases.members])
    group = np.repeat(np.arange(len(cases.members)), [len(m.held_out) for m in cases.members])
    ends = {(STILL, ""): (cases.start[held_out], np.ones(len(held_out), bool))}
    for name, of in found.items():
        for condition in (c for c in CONDITIONS if c in of):
            parts = of[condition]
            pose = np.concatenate([np.array(part["end"]) for part in parts])
            ends[name, condition] = pose, np.concatenate([part["good"] for part in parts])
    errors = {k: errors_in_mm_and_deg(pose, cases.end[held_out]) for k, (pose, _) in ends.items()}
    return {k: Scores(*errors[k], good, group) for k, (_, good) in ends.items()}


def _overall(
    key: tuple[str, str], scores: Mapping[tuple[str, str], Scores], found: Mapping[str, Any]
) -> Row:
    """Figures of one engine in one condition on all held-out pushes."""
    own, (name, condition) = scores[key], key
    parts = found.get(name, {}).get(condition, [])
    row: Row = {"engine": name, "condition": condition, "held_out": len(own.mm)}
    for unit, error in (("mm", own.mm), ("deg", own.deg)):
        row[f"mean_{unit}"], row[f"median_{unit}"] = float(error.mean()), float(np.median(error))
    row["within_5_mm"] = float((own.mm <= GOOD_MM).mean())
    row["failures"] = int((~own.good).sum())
    row["simulations"] = sum(part["simulations"] for part in parts)
    row["seconds"] = float(f"{sum(part['seconds'] for part in parts):.2g}")
    spent = sum(part["held_out_seconds"] for part in parts)
    row["milliseconds_per_push"] = 1e3 * spent / len(own.mm) if parts else None
    other = scores[BASELINE, SHIPPED if condition in ("", SHIPPED) else CALIBRATED]
    row["more_mm"], *row["more_mm_95"] = _difference(own.mm - other.mm, own.group)
    row["more_deg"], *row["more_deg_95"] = _difference(own.deg - other.deg, own.group)
    return row


def _difference(more: FloatArray, group: IntArray) -> tuple[float, float, float]:
    """Return the mean of paired differences, and its 95 % interval by resampling groups."""
    counts = np.bincount(group)
    sums = np.bincount(group, weights=more)
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(counts), size=(RESAMPLES, len(counts)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(more.mean()), float(low), float(high)


def _groups(cases: Cases, key: tuple[str, str], own: Scores) -> list[Row]:
    """Figures of one engine in one condition by surface, plate and speed."""
    held_out = np.concatenate([member.held_out for member in cases.members])
    speed = np.round(1e3 * cases.speed[held_out], 1)
    rows = []
    for k, member in enumerate(cases.members):
        for v in np.unique(speed[own.group == k]).tolist():
            some = (own.group == k) & (speed == v)
            rows.append(
                {
                    "engine": key[0],
                    "condition": key[1],
                    "surface": member.key[0],
                    "shape": member.key[1],
                    "speed_mm_s": v,
                    "held_out": int(some.sum()),
                    "within_5_mm": float((own.mm[some] <= GOOD_MM).mean()),
                    "mean_mm": float(own.mm[some].mean()),
                    "mean_deg": float(own.deg[some].mean()),
                    "failures": int((~own.good[some]).sum()),
                }
            )
    return rows


def _conclusion(row: Row) -> str:
    text = f"{row['data']}, {row['engine']} {row['condition']}".strip()
    more, (low, high) = row["more_mm"], row["more_mm_95"]
    return (
        f"{text}: {row['mean_mm']:.2f} / {row['median_mm']:.2f} mm, {row['mean_deg']:.2f} /"
        f" {row['median_deg']:.2f} deg, {100 * row['within_5_mm']:.1f} % within {GOOD_MM:g} mm,"
        f" {row['failures']} failures, {row['simulations']} simulations in {row['seconds']:g} s;"
        f" against {BASELINE} {more:+.2f} mm ({low:+.2f} to {high:+.2f})."
    )


def _data_of(cases: Cases, member: Member) -> list[Any]:
    """Data that the results of a group depend on."""
    some = np.concatenate((member.train, member.held_out, member.registered))
    paths = [cases.cases[k].scene.pushers[0].drive.waypoints for k in some.tolist()]
    return [member.key, cases.start[some], cases.end[some], np.array(paths)]
