"""Other simulators on the straight pushes of the MIT push dataset, before and after calibration.

Every engine simulates the same scenes: the plate on the same points of even pressure, the tip on a
rigid drive at its real speed. Every plate on every surface is calibrated on the same few pushes,
with the same parameters, start, priors and search. Held-out pushes have the outcome.

The settings below were chosen on training pushes of fixel alone, before an engine simulated a
held-out push.
"""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.calibration.cost import NormalPrior
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.optimiser import SearchBox
from fixel.calibration.registration import registration_from_gaps
from fixel.datasets.contact import pushed_scene
from fixel.datasets.mit_plates import TIP
from fixel.datasets.mit_push import STROKE
from fixel.io.result_cache import ResultCache, listed
from fixel.model import SupportPoints, wrapped
from fixel.model.engine_parameters import ENGINE_PARAMETERS
from fixel.model.footprint import support_grid
from fixel.replay.base import Row, errors_in_mm_and_deg
from fixel.replay.mit_pushes import NOMINAL, MitPushes, read_mit_pushes
from fixel.simulation.motion import motion_model, stated_name
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
    profile_beliefs,
    registration_beliefs,
    table_beliefs,
    tip_beliefs,
)
from reproductions.protocols import SHARE
from reproductions.pushes import Key, rows_by_key
from reproductions.residuals import few_of, random_split
from reproductions.result import Reproduction, RunOptions

TRAIN: Final = 12  # pushes of every plate and surface that calibrate
HELD_OUT: Final = 84  # pushes of every plate and surface that are scored, at most
ITERATIONS: Final = 4  # of the search
QUICK: Final = 4  # pushes of two plates, and one iteration
# Box2D refuses its outline of 128 corners, and Drake takes 6 s for each of its pushes.
LEFT_OUT: Final = frozenset({"ellip2"})
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


class Setting(NamedTuple):
    """Engine as it takes part: its own parameters to calibrate, and the effort of the search."""

    motion: str
    own: tuple[str, ...] = ()
    train: int = TRAIN  # pushes of every plate and surface
    iterations: int = ITERATIONS


SETTINGS: Final[Mapping[str, Setting]] = {
    "fixel": Setting("quasistatic"),
    "fixel dynamic": Setting("dynamic"),
    "Box2D": Setting("box2d", ("inertia_factor",)),
    "pymunk": Setting("pymunk", ("inertia_factor", "slop")),
    "MuJoCo": Setting("mujoco", ("timeconst", "width", "impratio")),
    "Drake": Setting("drake:step=0.01", train=6, iterations=1),
}
BASELINE: Final = "fixel"
SHIPPED, CALIBRATED, OWN = "as shipped", "calibrated", "with own parameters"
CONDITIONS: Final = (SHIPPED, CALIBRATED, OWN)
STILL: Final = "object does not move"


class Member(NamedTuple):
    """Pushes of one plate on one surface, by their places in the list of cases."""

    key: Key
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


class Ends(NamedTuple):
    """Simulated end poses."""

    pose: FloatArray  # (n, 3)
    good: BoolArray  # (n,)


def run(options: RunOptions) -> Reproduction:
    """Compare engines on held-out pushes, as shipped and calibrated.

    With `quick`, it uses two plates, few pushes and no Drake.
    """
    data = read_mit_pushes(options.folder)
    cases = select_cases(data, options.quick)
    cache = ResultCache(options.fits)
    settings = dict(SETTINGS)
    if options.quick:
        del settings["Drake"]
    found = {}
    for k, (name, setting) in enumerate(settings.items()):
        options.progress(k, len(settings), name)
        found[name] = _of_engine(setting, cases, cache, options)
    scores = _scores(cases, found)
    overall = [_overall(key, scores, found) for key in scores]
    groups = [row for key, own in scores.items() for row in _groups(cases, key, own)]
    return Reproduction(
        tables={"overall": overall, "groups": groups},
        conclusions=[_conclusion(row) for row in overall],
        settings={
            "quick": options.quick,
            "train": {name: own.train for name, own in settings.items()},
            "iterations": {name: own.iterations for name, own in settings.items()},
            "engines": {name: own["engine"] for name, own in found.items()},
        },
        figure=partial(engines_figure, groups),
    )


# --- pushes -----------------------------------------------------------------------------------


def select_cases(data: MitPushes, quick: bool) -> Cases:
    """Select the pushes of every plate and surface, of the first split of the benchmark."""
    members: list[Member] = []
    chosen: list[RolloutCase] = []
    rows: list[int] = []
    for key, own in rows_by_key(data, data.usable).items():
        if key[1] in LEFT_OUT or (quick and len(members) == 2):
            continue
        speeds = np.round(data.speed[own] * 1e3, 6).tolist()
        split = random_split(speeds, SHARE, 0)
        train = own[few_of(split, QUICK if quick else TRAIN, 0).train]
        train = np.random.default_rng(0).permutation(train)  # some engines take the first of them
        held_out = own[_spread(split.held_out, QUICK if quick else HELD_OUT)]
        shift = registration_from_gaps(
            data.bodies[key[1]].shape, TIP.radius, data.end[train], data.tip_end[train]
        ).shift
        places = []
        for some, by in ((train, shift), (held_out, np.zeros(2)), (held_out, shift)):
            places.append(len(rows) + np.arange(len(some)))
            chosen += [_case(data, row, by) for row in some.tolist()]
            rows += some.tolist()
        members.append(Member(key, *places))
    return Cases(tuple(members), tuple(chosen), data.start[rows], data.end[rows], data.speed[rows])


def _spread(rows: IntArray, most: int) -> IntArray:
    n = min(most, len(rows))
    return rows[np.arange(n) * len(rows) // n]


def _case(data: MitPushes, row: int, shift: FloatArray) -> RolloutCase:
    """Scene of a push at its real speed, with the tip moved by a shift and out of the plate."""
    body = data.bodies[str(data.shape[row])]
    support = SupportPoints(points=support_grid(body.shape)[0], friction=NOMINAL["mu_support"])
    duration = STROKE / float(data.speed[row])
    path = np.zeros((2, 4))
    path[1, 0] = duration
    path[0, 1:3], path[1, 1:3] = data.tip_start[row] + shift, data.tip_end[row] + shift
    body = replace(body, pose=data.start[row], support=support)
    scene, flags = pushed_scene(body, TIP, path, friction=NOMINAL["mu_pusher"])
    assert scene is not None, flags
    return RolloutCase(scene, np.array([duration]))


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
    for condition, beliefs in ((SHIPPED, ()), (CALIBRATED, SHARED), (OWN, (SHARED[0], *own))):
        if condition == OWN and not own:
            continue
        iterations = 1 if options.quick else setting.iterations
        found[condition] = []
        for full in cases.members:
            member = full._replace(train=full.train[: setting.train])
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
    """Calibrate one plate on one surface, and simulate its held-out pushes."""
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
    row["seconds"] = round(sum(part["seconds"] for part in parts), 1)
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
    speed = np.round(1e3 * cases.speed[held_out]).astype(int)
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
    text = f"{row['engine']} {row['condition']}".strip()
    more, (low, high) = row["more_mm"], row["more_mm_95"]
    return (
        f"{text}: {row['mean_mm']:.2f} / {row['median_mm']:.2f} mm, {row['mean_deg']:.2f} /"
        f" {row['median_deg']:.2f} deg, {100 * row['within_5_mm']:.1f} % within {GOOD_MM:g} mm,"
        f" {row['failures']} failures, {row['simulations']} simulations in {row['seconds']:.0f} s;"
        f" against {BASELINE} {more:+.2f} mm ({low:+.2f} to {high:+.2f})."
    )


def _data_of(cases: Cases, member: Member) -> list[Any]:
    """Data that the results of a group depend on."""
    some = np.concatenate((member.train, member.held_out, member.registered))
    paths = [cases.cases[k].scene.pushers[0].drive.waypoints for k in some.tolist()]
    return [member.key, cases.start[some], cases.end[some], np.array(paths)]
