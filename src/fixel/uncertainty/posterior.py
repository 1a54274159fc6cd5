"""Posterior of parameters by nested sampling: dynesty on the compiled batch of simulations.

Source: Skilling (2006), Bayesian Analysis 1, 833-859; Feroz, Hobson & Bridges (2009), MNRAS 398,
for bounds of several ellipsoids, which preserve separate minima; Speagle (2020), MNRAS
493, for dynesty.
"""

from __future__ import annotations

import math
import time as clock
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.known_pushes import KnownPushes
from fixel.calibration.noise import Noise
from fixel.calibration.result import find_solutions
from fixel.errors import InvalidInput, counted, require
from fixel.model.fields import whole
from fixel.model.space import ParameterSpace
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray, IntArray, ProgressCallback
from fixel.uncertainty.batched_sampler import Batched, BatchedSampler
from fixel.uncertainty.error_terms import LABEL, ModelError
from fixel.units import displayed

# Effective samples that a live point brings, over sqrt(n / 2): 2 sqrt(pi) = 3.5 for a normal
# posterior of n parameters.
SAMPLES_PER_LIVE: Final = 3.0
# With fewer, a minimum with a few percent of the probability would be lost.
MIN_LIVE: Final = 250
# Proposals computed together. The number does not affect correctness, only the share that is
# discarded because the limit has risen meanwhile: about half of this over the live points.
IN_FLIGHT: Final = 32
# Remaining evidence at which a run ends, as the logarithm of a factor.
REMAINING: Final = 0.02
# Volume of the ellipsoids over that of the smallest ones around the live points. dynesty's
# bootstrap for it costs six times as much as everything else here.
ENLARGED: Final = 1.5
# Evaluations per live point between two fits of the ellipsoids.
UPDATED: Final = 2.0
# Largest number of unknowns for which uniform draws within the bound are cheaper than walks.
MAX_FOR_UNIFORM: Final = 6
# Mean number of uniform draws per new point, over as many points as there are live ones, above
# which the run switches to walks of 20 + n steps: a rough likelihood fills little of an ellipsoid.
DEAR: Final = 40
# Maximum number of runs merged to reach the requested number of effective samples.
MAX_RUNS: Final = 6
# Share of the probability below which a cluster of samples is not a mode of its own.
MIN_MODE: Final = 0.01
# Minimum number of returned samples, if there are as many effective ones: with fewer, the samples
# of one mode are too far from each other to be recognised as one.
MIN_BACK: Final = 1000
# Shortest time between two calls of the progress callback [s].
BETWEEN: Final = 0.2


class Evidence(NamedTuple):
    """Probability of the data under the prior, for comparing models of the same data."""

    log: float  # natural logarithm
    error: float  # its standard error


class Mode(NamedTuple):
    """Separate part of the posterior."""

    weight: float  # share of the probability
    best: FloatArray  # (n,) its likeliest sample
    log_likelihood: float  # there
    low: FloatArray  # (n,) 2.5 % quantile of each parameter
    high: FloatArray  # (n,) 97.5 %
    members: IntArray  # rows of the equal-weight samples


@final
@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Posterior(Result):
    """Samples of equal weight from a posterior, with their quality.

    Made by `fixel.posterior`.

    Attributes
    ----------
    labels, units : tuple of str
        Names and units of the n unknowns.
    low, high : (n,) float64
        Bounds of the prior.
    points : (k, n) float64
        Samples of equal weight, one column per unknown.
    log_likelihood : (k,) float64
        Log likelihood of the samples.
    log_evidence, log_evidence_error : float
        Natural logarithm of the probability of the data under the prior, and its standard error.
    effective : float
        Kish's number of effective samples, before they were given equal weight.
    information : float
        Information that the data add to the prior [nats].
    evaluations, failed : int
        Number of evaluated points, and of those that could not be simulated.
    modes : tuple of Mode
        Separate parts, the heaviest first; one if there are no separate parts.
    seconds : float
    seed : int
    method : str
        Description of the sampler.
    space : ParameterSpace, optional
        Parameters with their bounds; None for a likelihood that is no experiment's.
    noise : Noise, optional
        Noise of the camera.
    model_error : ModelError, optional
        Prior of the standard deviation of the model's own error; None without this term.
    motion : str
        Name of the motion model.
    experiments : tuple of str
        Names of the experiments.
    known : KnownPushes, optional
        Parts, surfaces, sides and speeds of the experiments.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.pushes import example_pushes
    >>> pushes = example_pushes(1, duration=0.3)
    >>> space = {"mu_pusher": (0, 1), "tripod_radius": 0.038}
    >>> found = fixel.posterior(pushes, space, model_error=False, samples=20, progress=False)
    >>> found.labels
    ('mu_pusher',)
    >>> found.points.shape[1]
    1
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    low: FloatArray
    high: FloatArray
    points: FloatArray
    log_likelihood: FloatArray
    log_evidence: float
    log_evidence_error: float
    effective: float
    information: float
    evaluations: int
    failed: int
    modes: tuple[Mode, ...]
    seconds: float
    seed: int
    method: str = ""
    space: ParameterSpace | None = None
    noise: Noise | None = None
    model_error: ModelError | None = None
    motion: str = ""
    experiments: tuple[str, ...] = ()
    known: KnownPushes | None = None

    @property
    def samples(self) -> Mapping[str, FloatArray]:
        """Samples (k,) of every unknown, by label."""
        return dict(zip(self.labels, self.points.T, strict=True))

    @property
    def evidence(self) -> Evidence:
        """Logarithm of the evidence, with its standard error."""
        return Evidence(self.log_evidence, self.log_evidence_error)

    def quantiles(self, levels: tuple[float, ...] = (0.025, 0.5, 0.975)) -> FloatArray:
        """Return the quantiles (len(levels), n) of the parameters."""
        return np.asarray(np.quantile(self.points, levels, axis=0))

    @property
    def best(self) -> FloatArray:
        """Sample (n,) of the largest likelihood."""
        return np.asarray(self.points[int(np.argmax(self.log_likelihood))])

    def summary(self) -> Table:
        """Return median, 95 % interval, likeliest value and bounds of every unknown [mm, deg]."""
        numbers = (Column(c, format=".3g") for c in ("median", "2.5 %", "97.5 %", "likeliest"))
        values, rows = np.vstack((self.quantiles()[[1, 0, 2]], self.best)).T, []
        for k, prior in enumerate(self._ranges(self.low, self.high)):
            unit = displayed(self.units[k])
            rows.append((self.labels[k], *(unit.factor * values[k]), prior, unit.name or "-"))
        return Table(("parameter", *numbers, "prior", "unit"), rows, title="Parameters")

    def _ranges(self, low: FloatArray, high: FloatArray) -> list[str]:
        ends = zip(map(displayed, self.units), low, high, strict=True)
        return [f"{unit.text(first)} .. {unit.text(last)}" for unit, first, last in ends]

    def tables(self) -> list[Table]:
        """Return the table of the unknowns, and one of the modes if there are several."""
        if len(self.modes) < 2:
            return [self.summary()]
        own = zip(self.labels, self.units, strict=True)
        names = [Column(label, displayed(unit).name) for label, unit in own]
        head: tuple[Column | str, ...] = ("mode", Column("probability", "%", ".0f"), *names)
        rows = [
            (k, 100.0 * mode.weight, *self._ranges(mode.low, mode.high))
            for k, mode in enumerate(self.modes, 1)
        ]
        return [self.summary(), Table(head, rows, title="Separate modes, 95 % of each")]

    @property
    def note(self) -> str:
        """Sentence on the number of samples and the evidence."""
        return (
            f"{self.effective:.0f} effective samples from {self.evaluations} simulated points;"
            f" log evidence {self.log_evidence:.2f} +- {self.log_evidence_error:.2f}"
        )

    def to_arviz(self) -> Any:
        """Return the samples in ArviZ's container, as one chain.

        Raises
        ------
        MissingExtra
            ArviZ is not installed.
        """
        require("arviz", "to_arviz", command="pip install arviz")
        arviz = import_module("arviz")
        chain = {name: x[None] for name, x in self.samples.items()}
        if arviz.__version__.startswith("0."):
            return arviz.from_dict(posterior=chain)
        return arviz.from_dict({"posterior": chain})

    def under(self, conditions: Mapping[str, str | float]) -> Posterior:
        """Return the posterior of the parameters that apply under conditions of an experiment."""
        space = self.searched
        if all(unknown.covers(conditions) for unknown in space.unknowns):
            return self
        own = ParameterSpace(unknowns=tuple(u for u in space.unknowns if u.covers(conditions)))
        kept = [k for k, label in enumerate(self.labels) if label in (*own.labels, LABEL)]
        return replace(
            self,
            labels=tuple(self.labels[k] for k in kept),
            units=tuple(self.units[k] for k in kept),
            low=self.low[kept],
            high=self.high[kept],
            points=self.points[:, kept],
            modes=(),
            space=own,
        )

    def values(
        self, points: FloatArray, conditions: Mapping[str, str | float]
    ) -> dict[str, FloatArray]:
        """Return the parameters (m,) at points (m, n), by name, for one experiment."""
        space = self.searched
        return space.columns(points[:, : len(space.labels)], conditions)

    @property
    def searched(self) -> ParameterSpace:
        """Parameters with their bounds; raises where there are none."""
        if self.space is None:
            expected = "a result of fixel.posterior"
            raise InvalidInput("model", found="a posterior without parameters", expected=expected)
        return self.space

    def _summary(self) -> Summary:
        n = len(self.experiments)
        of = f" of {counted(n, 'experiment')}" if n else ""
        return Summary(
            f"Posterior{of}" + (f" ({self.motion})" if self.motion else ""),
            self.tables(),
            [self.note],
            {"method": self.method, "seed": str(self.seed)},
        )

    def _data(self) -> Table:
        """Return the samples, one row each."""
        columns = [Column(*pair) for pair in zip(self.labels, self.units, strict=True)]
        return Table(columns, self.points.tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class NestedSampling:
    """Settings of nested sampling."""

    # Required number of effective samples; at least as many of equal weight are returned.
    samples: int = 1000
    # Number of live points; by default chosen from `samples`, at least `MIN_LIVE`.
    live: int | None = None
    # Random walks instead of uniform draws; by default with more than six unknowns.
    walks: bool | None = None

    def __post_init__(self) -> None:
        whole(self.samples, "samples", 10, 1_000_000)
        if self.live is not None:
            whole(self.live, "live", 20)

    def sample(
        self,
        log_likelihood: Batched,
        prior: Any,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> Posterior:
        """Return samples of the posterior, bit for bit the same for the same seed.

        The likelihood is a finite function of points (k, n) -> (k,), `FLOOR` where a simulation
        fails. The prior is any object with `labels`, `units`, `low`, `high` and `transform`. Raise
        `MissingExtra` without dynesty, `InvalidInput` for a likelihood without any value.
        """
        merge_runs = _dynesty().utils.merge_runs
        begun = clock.perf_counter()
        count = _Count(progress)
        pool = BatchedSampler(log_likelihood, prior.transform, count)
        runs: list[Any] = []
        for k in range(MAX_RUNS):
            rng = np.random.Generator(np.random.PCG64([seed, k]))
            runs.append(self._run(pool, log_likelihood, prior, rng, count))
            merged = runs[0] if k == 0 else merge_runs(list(runs), print_progress=False)
            weights = merged.importance_weights()
            effective = float(np.sum(weights) ** 2 / np.sum(weights**2))  # Kish
            if effective >= self.samples:
                break
        rng = np.random.Generator(np.random.PCG64([seed, MAX_RUNS]))
        count_back = max(self.samples, min(MIN_BACK, int(effective)))
        rows = equal_weight(weights, count_back, rng)
        samples, values = merged.samples[rows], merged.logl[rows]
        evidence = float(merged.logz[-1])
        information = _information(weights, merged.logl, evidence)
        live = self._live(len(prior.labels)) * len(runs)
        count.show(1000)
        return Posterior(
            labels=prior.labels,
            units=prior.units,
            low=prior.low,
            high=prior.high,
            points=np.ascontiguousarray(samples),
            log_likelihood=values,
            log_evidence=evidence,
            log_evidence_error=math.sqrt(information / live),
            effective=effective,
            information=information,
            evaluations=count.evaluations,
            failed=int(getattr(log_likelihood, "failed", 0)),
            modes=modes_of(samples, values),
            seconds=clock.perf_counter() - begun,
            seed=seed,
            method=self._method(len(prior.labels), len(runs)),
        )

    def _walks(self, n: int) -> bool:
        return n > MAX_FOR_UNIFORM if self.walks is None else self.walks

    def _live(self, n: int) -> int:
        wanted = math.ceil(self.samples / (SAMPLES_PER_LIVE * math.sqrt(0.5 * n)))
        return max(MIN_LIVE, 25 * n, wanted) if self.live is None else self.live

    def _method(self, n: int, runs: int) -> str:
        how = (
            "random walks"
            if self._walks(n)
            else "uniform draws (random walks where these are expensive)"
        )
        several = "" if runs == 1 else f", {runs} runs combined"
        return f"nested sampling, {self._live(n)} live points, {how} in several ellipsoids{several}"

    def _run(
        self,
        pool: BatchedSampler,
        log_likelihood: Batched,
        prior: Any,
        rng: np.random.Generator,
        count: _Count,
    ) -> Any:
        n = len(prior.labels)
        with warnings.catch_warnings():
            # dynesty warns of a plateau at the start: failed simulations, which all have FLOOR.
            warnings.filterwarnings("ignore", category=RuntimeWarning, module="dynesty")
            warnings.filterwarnings("ignore", category=UserWarning, module="dynesty")
            sampler = _dynesty().NestedSampler(
                lambda point: float(log_likelihood(np.asarray(point)[None])[0]),
                lambda unit: prior.transform(np.asarray(unit)[None])[0],
                n,
                nlive=self._live(n),
                bound="multi",
                sample="rwalk" if self._walks(n) else "unif",
                rstate=rng,
                pool=pool,
                queue_size=min(IN_FLIGHT, max(1, self._live(n) // 4)),
                use_pool={"prior_transform": False, "update_bound": False},
                enlarge=ENLARGED,
                bootstrap=0,
                update_interval=UPDATED,
            )
            _check_any_likelihood(sampler.live_logl)
            walking, spent, taken = self._walks(n), 0, 0
            for step in sampler.sample(dlogz=REMAINING, save_bounds=False):
                count.left(float(step.delta_logz))
                spent, taken = spent + step.nc, taken + 1
                if not walking and spent > DEAR * self._live(n):
                    _walk_on(sampler, n)
                    walking = True
                elif taken >= self._live(n):
                    spent = taken = 0
            for _ in sampler.add_live_points():
                pass
        return sampler.results


class _Count:
    """Counter of evaluated points that reports the progress of a run in thousandths."""

    def __init__(self, progress: ProgressCallback | None) -> None:
        self._progress = progress
        self.evaluations = self._done = 0
        self._reported = clock.monotonic()
        self._most = 1.0

    def __call__(self, n: int) -> None:
        self.evaluations += n

    def left(self, remaining: float) -> None:
        """Report the remaining evidence, as the logarithm of a factor."""
        now = clock.monotonic()
        if now - self._reported < BETWEEN:
            return
        self._reported = now
        finite = min(remaining, 1e6)
        self._most = max(self._most, finite)
        span = math.log1p(self._most / REMAINING)
        share = 1.0 - math.log1p(max(finite - REMAINING, 0.0) / REMAINING) / span
        self.show(min(round(1000.0 * min(max(share, 0.0), 1.0)), 999))

    def show(self, done: int) -> None:
        """Report progress that never decreases."""
        self._done = max(self._done, done)
        if self._progress is not None:
            self._progress(self._done, 1000, f"{self.evaluations} points")


def equal_weight(weights: FloatArray, count: int, rng: np.random.Generator) -> IntArray:
    """Return rows (count,) by systematic resampling with weights, in random order."""
    place = (rng.random() + np.arange(count)) / count
    rows = np.searchsorted(np.cumsum(weights) / np.sum(weights), place)
    return np.asarray(rng.permutation(np.minimum(rows, len(weights) - 1)))


def modes_of(samples: FloatArray, log_likelihood: FloatArray) -> tuple[Mode, ...]:
    """Return the separate parts of samples (k, n) of equal weight.

    Samples closer than 0.5 sqrt(n) standard deviations are linked. Samples of the tails, in parts
    that are too small, are added to the nearest large part.
    """
    k, n = samples.shape
    scale = np.maximum(samples.std(axis=0), 1e-12 * np.maximum(1e-300, np.abs(samples).max(axis=0)))
    scale = np.where(scale > 0.0, scale, 1.0)
    found = find_solutions(
        samples, -log_likelihood, scale, threshold=1e300, distance=0.5 * math.sqrt(n)
    )
    large = [one.members for one in found if one.size >= MIN_MODE * k] or [np.arange(k)]
    label = np.full(k, -1)
    for number, members in enumerate(large):
        label[members] = number
    stray = np.flatnonzero(label < 0)
    if len(stray):
        from scipy.spatial import cKDTree

        home = np.flatnonzero(label >= 0)
        label[stray] = label[home[cKDTree(samples[home] / scale).query(samples[stray] / scale)[1]]]
    modes = [_mode(samples, log_likelihood, np.flatnonzero(label == j)) for j in range(len(large))]
    return tuple(sorted(modes, key=lambda mode: -mode.weight))


def _mode(samples: FloatArray, log_likelihood: FloatArray, members: IntArray) -> Mode:
    own = samples[members]
    best = int(members[int(np.argmax(log_likelihood[members]))])
    low, high = np.quantile(own, (0.025, 0.975), axis=0)
    weight = len(members) / len(samples)
    return Mode(weight, samples[best].copy(), float(log_likelihood[best]), low, high, members)


def _information(weights: FloatArray, log_likelihood: FloatArray, log_evidence: float) -> float:
    """Return the information that data add to a prior [nats]; Skilling (2006), eq. 15. dynesty's
    own value is NaN if some likelihoods are practically zero."""
    share = np.asarray(weights) / np.sum(weights)
    counted = share > 0.0
    mean = float(share[counted] @ np.asarray(log_likelihood, np.float64)[counted])
    return max(0.0, mean - log_evidence)


def _dynesty() -> Any:
    require("dynesty", "a posterior", extra="infer")
    import dynesty

    return dynesty


def _walk_on(sampler: Any, n: int) -> None:
    """Switch the sampler from uniform draws to random walks."""
    from dynesty.internal_samplers import RWalkSampler

    walks = 20 + n
    sampler.internal_sampler = sampler.internal_sampler_next = RWalkSampler(
        ndim=n, ncdim=n, walks=walks, facc=0.5, nonbounded=None, periodic=None, reflective=None
    )
    sampler.bound_update_interval = walks * sampler.nlive


def _check_any_likelihood(values: FloatArray) -> None:
    from fixel.uncertainty.likelihood import FLOOR

    if not (np.asarray(values, np.float64) > FLOOR).any():
        found = "no point of the prior that could be simulated"
        hint = "narrow the bounds to values with which the experiments can be simulated"
        raise InvalidInput("posterior", found=found, expected="at least one point", hint=hint)
