"""Simulation-based calibration of the particle filter: truths drawn from its own prior.

Free pushes and pushes against fixels, near (one to three are touched) and far; noise of object,
pusher and fixels as the filter believes it. No seed here was used to choose anything. Each truth
adds rows to `ROWS`: a run that was stopped continues. Delete the file when the filter changes.
`run_wrong` measures the same where a belief is wrong.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import chi2, kstest

from benchmarks.figures import Bar, Figure, Size, at_least, at_most
from benchmarks.report import RESULTS
from fixel.filtering.particle_filter import DEFAULT_PRIORS, ParticleFilter
from fixel.filtering.recorded import run_filter
from fixel.model import Experiment, PlannedExperiment, Tripod, wrapped
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import grasp, row

TRUTHS: Final = 200
FIRST: Final = 8000  # never looked at while the method was made
WRONG: Final = 24  # truths for each wrong belief
PARTICLES: Final = 125
FEW: Final = 20  # only to see whether it runs
ROWS: Final = RESULTS / "filter-coverage.csv"
ROWS_WRONG: Final = "filter-coverage-{}.csv"
HEAD: Final = ("seed", "parameter", "truth", "rank", "low", "high", "ellipsoids")
DURATION: Final = 4.5  # [s]
HALF: Final = 0.05375  # [m] of the square's side
FRONT: Final = 0.0145  # [m] of the head
NEARER: Final = {"slip": 0.075, "seated": 0.035}  # [m] by which pegs stand nearer than in `grasp`


class Bench(NamedTuple):
    """Differences between a laboratory and the beliefs of the filter."""

    noise: float = 1.0  # of the camera, times the belief
    imperfect: bool = False  # the default `SimulatedTestbed`: pressure on 24 points, uneven drive


BENCHES: Final = {
    "half the noise": Bench(noise=0.5),
    "twice the noise": Bench(noise=2.0),
    "imperfect": Bench(imperfect=True),
}


RIGHT: Final = Bench()
PERFECT: Final = (
    *("support_friction", "pusher_friction", "fixel_friction", "position_noise", "angle_noise"),
    *("dropped_frames", "false_contact", "missed_contact"),
)  # also of an imperfect bench: truths stay as drawn, and `camera` errs instead
BARS: Final = (at_least(0.86), at_most(0.94))


class RunCoverage(NamedTuple):
    """Ranks and coverage of one run."""

    rank: dict[str, float]  # share of the particles' weight below the truth
    low: dict[str, float]
    high: dict[str, float]
    truth: dict[str, float]
    ellipsoids: float  # share of the 90 % ellipsoids of the pose that hold the true one


def run(size: Size) -> list[Figure]:
    """Measure how even ranks are and how often 90 % intervals and ellipsoids hold the truth."""
    full = size.rollouts >= 500
    return figures_of(_rows(TRUTHS if full else 2, ROWS if full else None, RIGHT, full))


def run_wrong(size: Size) -> list[Figure]:
    """Measure the same with other noise than believed, and in an imperfect laboratory; no bars."""
    full, figures = size.rollouts >= 500, []
    for label, bench in BENCHES.items():
        path = RESULTS / ROWS_WRONG.format(label.replace(" ", "-"))
        rows = _rows(WRONG if full else 1, path if full else None, bench, full)
        figures += figures_of(rows, label, (None,))
    return figures


def _rows(n: int, path: Path | None, bench: Bench, full: bool) -> list[dict[str, str]]:
    known = []
    if path is not None and path.is_file():
        with path.open(newline="") as file:
            known = list(csv.DictReader(file))
    done = {int(row["seed"]) for row in known}
    for seed in range(FIRST, FIRST + n):
        if seed in done:
            continue
        one = held(seed, PARTICLES if full else FEW, bench)
        rows = [
            (seed, name, one.truth[name], rank, one.low[name], one.high[name], one.ellipsoids)
            for name, rank in one.rank.items()
        ]
        known += [dict(zip(HEAD, map(str, row), strict=True)) for row in rows]
        if path is not None:
            fresh = not path.is_file()
            with path.open("a", newline="") as file:
                csv.writer(file).writerows([HEAD, *rows] if fresh else rows)
    return known


def figures_of(
    rows: list[dict[str, str]], label: str = "SBC", bars: Sequence[Bar | None] = BARS
) -> list[Figure]:
    """Figures of as many truths as there are rows of."""
    figures = []
    for name in DEFAULT_PRIORS:
        own = [row for row in rows if row["parameter"] == name]
        truth, rank, low, high = (
            np.array([float(row[key]) for row in own]) for key in ("truth", "rank", "low", "high")
        )
        if not np.isfinite(truth).all():
            continue
        inside = float(np.mean((low <= truth) & (truth <= high)))
        uniform = float(kstest(rank, "uniform").pvalue)
        title = f"filter, {label}, {name} ({len(own)})"
        if bars is BARS:
            figures.append(Figure(f"{title}, uniformity", "-", (uniform,), at_least(0.01)))
        figures += [Figure(f"{title}, 90 % held", "-", (inside,), bar) for bar in bars]
    each = {row["seed"]: float(row["ellipsoids"]) for row in rows}
    share = float(np.mean(list(each.values())))
    title = f"filter, {label}, 90 % ellipsoids ({len(each)})"
    return [*figures, *(Figure(title, "-", (share,), bar) for bar in bars)]


def held(seed: int, particles: int = PARTICLES, bench: Bench = RIGHT) -> RunCoverage:
    """Draw a truth, record it, filter it."""
    truth, exact, measured = drawn(seed, bench)
    found = run_filter(measured, ParticleFilter(n_particles=particles), seed=seed)
    track = exact.trajectory
    pose = np.column_stack([np.interp(found.time, track.time, track.pose[:, k]) for k in range(3)])
    away = found.pose - pose
    away[:, 2] = wrapped(away[:, 2])
    inverse = np.linalg.inv(found.covariance + 1e-14 * np.eye(3))
    square = np.einsum("ni,nij,nj->n", away, inverse, away)
    names = found.prior.names
    last = found.quantiles[-1]
    below = np.mean(found.draws < [truth[name] for name in names], axis=0)
    return RunCoverage(
        rank=dict(zip(names, below.tolist(), strict=True)),
        low=dict(zip(names, last[:, 0].tolist(), strict=True)),
        high=dict(zip(names, last[:, 2].tolist(), strict=True)),
        truth=truth,
        ellipsoids=float(np.mean(square < chi2.ppf(0.9, 3))),
    )


def drawn(seed: int, bench: Bench = RIGHT) -> tuple[dict[str, float], Experiment, Experiment]:
    """A truth from the prior, its run as it was, and as the laboratory has measured it.

    NaN for a parameter that has no true value there.
    """
    random = np.random.default_rng([77, seed])
    layout = ("free", "slip", "seated")[seed % 3]
    scene = grasp("seated" if layout == "seated" else "slip")
    truth = {name: float(random.uniform(*ends)) for name, ends in DEFAULT_PRIORS.items()}
    body, head = scene.bodies[0], scene.pushers[0]
    turn = random.uniform(-math.pi / 4, math.pi / 4)
    aside = HALF * (abs(np.cos(turn)) + abs(np.sin(turn)))
    pose = row(FRONT + aside + random.uniform(0.002, 0.006), random.uniform(-0.015, 0.015), turn)
    support = Tripod(radius=truth["tripod_radius"], friction=truth["mu_support"], angle=math.pi / 2)
    pegs = () if layout == "free" else scene.fixels
    scene = replace(
        scene,
        bodies=(replace(body, pose=pose, support=support),),
        pushers=(replace(head, friction=truth["mu_pusher"]),),
        fixels=tuple(
            replace(peg, pose=peg.pose - row(NEARER[layout], 0.0, 0.0), friction=truth["mu_fixel"])
            for peg in pegs
        ),
        duration=DURATION,
    )
    planned, lab = PlannedExperiment(name=f"x{seed}", scene=scene), SimulatedTestbed.ideal(seed)
    if bench.imperfect:
        perfect = {name: getattr(lab, name) for name in PERFECT}
        lab = replace(SimulatedTestbed(seed=seed), **perfect)
        truth["tripod_radius"] = math.nan  # 24 points carry the object
    belief = ParticleFilter()
    camera = replace(
        lab,
        position_noise=bench.noise * belief.position_deviation,
        angle_noise=bench.noise * belief.angle_deviation,
        false_contact=1.0 - belief.no_contact_reliability,
        missed_contact=1.0 - belief.contact_reliability,
    )
    (exact,), (measured,) = lab.run([planned], threads=1), camera.run([planned], threads=1)
    return truth, exact, measured
