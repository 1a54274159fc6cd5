"""Statistics of planning on problems with known truths: races, probabilities, trials, causes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.stats import binom

from benchmarks.figures import Figure, Size, at_least, at_most
from fixel.calibration.study import run_study
from fixel.planning.causes import Explanation
from fixel.planning.race import RaceRequest, RaceResult, race_rounds
from fixel.planning.success import SuccessProbability
from fixel.planning.trials import evidence_against
from fixel.typing import FloatArray

N: Final = 1024  # scenarios of a race
FRESH: Final = 4096
MAX_ALARMS: Final = 0.064  # 5 %, and the sampling error of 1500 courses
KINDS: Final = ("light tails", "heavy tails", "ties", "correlated", "hard", "worlds")
RATES: Final[dict[str, Callable[[np.random.Generator, int], FloatArray]]] = {
    "all alike": lambda rng, n: np.full(n, 0.9),
    "beta(9, 1)": lambda rng, n: rng.beta(9.0, 1.0, n),
    "beta(0.5, 0.2)": lambda rng, n: rng.beta(0.5, 0.2, n),
    "0 or 1": lambda rng, n: (rng.random(n) < 0.8).astype(np.float64),
    "two kinds": lambda rng, n: np.where(rng.random(n) < 0.9, 0.98, 0.5),
    "logistic": lambda rng, n: 1.0 / (1.0 + np.exp(-3.0 - 2.0 * rng.normal(size=n))),
}


def run(size: Size) -> list[Figure]:
    """Return all figures; fewer and smaller problems for a small size."""
    full = size.rollouts >= 500
    figures = _races(40 if full else 2, 1024 if full else 64)
    figures += _selection_bias(1000 if full else 20)
    figures += _worst_draws(1000 if full else 20)
    figures += _trials(1500 if full else 20)
    return figures + _value_of_measuring(100 if full else 2)


# --- races ---------------------------------------------------------------------------------------


def problem(kind: str, n_plans: int, seed: int) -> FloatArray:
    """Margins (n_plans, N + FRESH) of plans with middle, sensitivity to unknowns, and noise."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    n = N + FRESH
    middle = rng.normal(-0.5, 0.8, n_plans)
    sensitivity = rng.normal(0.0, 0.4, (n_plans, 6))
    if kind == "ties":
        middle = rng.choice([-0.5, 0.0, 0.5, 1.2], n_plans)
        sensitivity = 0.5 * sensitivity[rng.integers(0, 8, n_plans)]
    if kind == "correlated":
        sensitivity = 0.2 * sensitivity + rng.normal(0.0, 0.5, 6)
    if kind == "hard":
        middle -= 1.5
    unknowns = rng.normal(size=(6, n))
    if kind == "worlds":  # 64 parameter draws of three unknowns; of the others each run its own
        unknowns[:3] = unknowns[:3, np.arange(n) % 64]
    noise = rng.standard_t(2, (n_plans, n)) if kind == "heavy tails" else None
    noise = rng.normal(size=(n_plans, n)) if noise is None else noise
    spread = rng.uniform(0.2, 0.8, (n_plans, 1))
    return np.asarray(middle[:, None] + sensitivity @ unknowns + spread * noise)


def _races(n_problems: int, n_plans: int) -> list[Figure]:
    figures = []
    for kind in KINDS:
        same, loss, share = [], [], []
        uniform: dict[int, list[float]] = {n: [] for n in (8, 16, 32, 64, 128, 256, 512, N)}
        for seed in range(n_problems):
            margins = problem(kind, n_plans, seed)
            seen, true = margins[:, :N], np.mean(margins[:, N:] >= 0.0, axis=1)
            found = run_study(race_rounds(n_plans), _lookup(seen))
            best = found.plans[0]
            rate = np.mean(seen >= 0.0, axis=1)
            same.append(rate[best] >= rate.max() - 0.002)
            share.append(found.rounds[-1].rollouts / seen.size)
            loss.append(true.max() - true[best])
            for n, losses in uniform.items():
                losses.append(true.max() - true[np.argmax(np.mean(seen[:, :n] >= 0.0, axis=1))])
        # The fewest scenarios for each plan with which a uniform race loses no more.
        alike = min(n for n in uniform if n == N or np.mean(uniform[n]) <= np.mean(loss) + 1e-4)
        name = f"race, {kind}"
        figures += [
            Figure(f"{name}, plan of a uniform race found", "-", (float(np.mean(same)),)),
            Figure(f"{name}, share of its rollouts", "-", (float(np.mean(share)),), at_most(0.1)),
            Figure(f"{name}, success lost", "-", (float(np.mean(loss)),)),
            Figure(
                f"{name}, rollouts of an equally good uniform race",
                "times",
                (float(alike / N / np.mean(share)),),
                at_least(10.0),
            ),
        ]
    return figures


def _lookup(margins: FloatArray) -> Callable[[RaceRequest], FloatArray]:
    return lambda wanted: margins[np.ix_(*wanted)]


# --- success probabilities -----------------------------------------------------------------------


def _selection_bias(n_problems: int) -> list[Figure]:
    """Return how often bounds are above the truth, for 256 plans that all succeed with 0.80."""
    rng = np.random.default_rng(0)
    own, fresh, divided = [], [], []
    for _ in range(n_problems):
        found = _flat_race(rng)
        own.append(float(found.success[found.plans[0]]))
        fresh.append(SuccessProbability.of(_flat(rng, FRESH)).low > 0.8)
        divided.append(SuccessProbability.of(_flat(rng, (64, 64))).least > 0.8)
    return [
        Figure("selection, success in the race of plans with 0.80", "-", (float(np.mean(own)),)),
        Figure("selection, fresh bound above", "-", (float(np.mean(fresh)),), at_most(0.04)),
        Figure("selection, least rate above", "-", (float(np.mean(divided)),), at_most(0.064)),
    ]


def _flat(rng: np.random.Generator, shape: int | tuple[int, ...]) -> FloatArray:
    return np.where(rng.random(shape) < 0.8, 0.5, -0.5)


def _flat_race(rng: np.random.Generator) -> RaceResult:
    return run_study(race_rounds(256), lambda wanted: _flat(rng, (*map(len, wanted),)))


def _worst_draws(n_problems: int) -> list[Figure]:
    """Return how many further parameter draws have a lower rate than the least one stated."""
    figures = []
    for name, rates in RATES.items():
        rng = np.random.default_rng(1)
        many = np.sort(rates(rng, 200_000))
        below = []
        for _ in range(n_problems):
            worlds = rates(rng, 256)[:, None] - rng.random((256, 16))
            draws = rates(rng, 2400) - rng.random(2400)
            least = SuccessProbability.of(worlds, independent=draws).least
            below.append(float(np.searchsorted(many, least)) / len(many))
        label = f"least rate, {name}, draws below"
        figures.append(Figure(label, "-", (float(np.mean(below)),), at_most(0.065)))
    return figures


# --- trials --------------------------------------------------------------------------------------


def _trials(n_courses: int) -> list[Figure]:
    figures = []
    for stated in (0.95, 0.9, 0.8):
        rng = np.random.default_rng(2)
        alarms = _refuted(rng, stated, stated, 1000, n_courses)
        power = _refuted(rng, stated, stated - 0.15, 40, 4 * n_courses)
        most = _largest_power(stated)
        enough = min(0.9, most - 0.02)
        name = f"trials, stated {stated:g}"
        figures += [
            Figure(
                f"{name}, refuted within 1000 though right", "-", (alarms,), at_most(MAX_ALARMS)
            ),
            Figure(f"{name}, refuted within 40 at -15 points", "-", (power,), at_least(enough)),
            Figure(f"{name}, most that any test can", "-", (most,)),
        ]
    return figures


def _refuted(rng: np.random.Generator, stated: float, truth: float, n: int, courses: int) -> float:
    found = [evidence_against(stated, rng.random(n) < truth).max() >= 20.0 for _ in range(courses)]
    return float(np.mean(found))


def _largest_power(stated: float) -> float:
    """Power of the randomised test of Neyman and Pearson on all of 40 trials."""
    truth = stated - 0.15
    number = np.arange(42)
    critical = int(np.argmax(binom.sf(number - 1, 40, 1.0 - stated) <= 0.05))
    left = 0.05 - binom.sf(critical - 1, 40, 1.0 - stated)
    ratio = binom.pmf(critical - 1, 40, 1.0 - truth) / binom.pmf(critical - 1, 40, 1.0 - stated)
    return float(binom.sf(critical - 1, 40, 1.0 - truth) + left * ratio)


# --- causes --------------------------------------------------------------------------------------


def _value_of_measuring(n_problems: int) -> list[Figure]:
    nothing, everything = [], []
    for seed in range(n_problems):
        rng = np.random.default_rng([3, seed])
        chance = rng.uniform(0.6, 0.9, (64, 1))
        margins = np.where(rng.random((64, N)) < chance, 0.5, -0.5)
        nothing.append(Explanation.of(margins, {"value": rng.normal(size=N)}).effects[0].worth)
        value, limit = rng.random(N), rng.uniform(0.2, 0.8)
        found = Explanation.of(np.stack([limit - value, value - limit]), {"value": value})
        everything.append(found.effects[0].worth / found.regret)
    zero = float(np.mean(np.array(nothing) == 0.0))
    return [
        Figure("causes, no influence, worth exactly 0", "-", (zero,), at_least(0.95)),
        Figure("causes, no influence, largest worth", "-", (max(nothing),)),
        Figure("causes, decides all, share of regret", "-", (float(np.median(everything)),)),
    ]
