"""Errors on parts that were left out as a whole: what a prediction for a new part is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fixel.parts import fit
from fixel.typing import FloatArray, IntArray, ProgressCallback

# Weights of the others' mean load among which leaving parts out chooses.
SHARES: Final = (0.0, 0.5, 1.0)
# Largest number of pushes of a group that are predicted.
MAX_TEST: Final = 100
# Errors of pushes that a fit assumes [m]: single pushes are heavy-tailed, and the model itself is
# off by millimetres, so that a few of them are believed less.
FEW, MANY = 5, 10
NOISE_OF_FEW, NOISE_OF_MANY = 5e-3, 2.5e-3
# Numbers of pushes for which bounds are learned; others use the next smaller one.
LADDER: Final = (0, 1, 2, 3, 5, 10, 20, 40)

Groups = Mapping[tuple[str, str], fit.PartPushes]  # by surface and part


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeftOutEnds:
    """Predictions of parts that were left out as a whole."""

    pushes: int  # number of pushes of each part that its prediction has used
    # Part of each push (n,), and surface and part.
    part: tuple[str, ...]
    group: tuple[str, ...]
    features: FloatArray  # (n, f) what is known of each push before it is made
    # (n, 2) Errors of position [m] and angle [rad]; inf where the simulation failed.
    errors: FloatArray


def noise_of(n: int) -> float:
    """Return the size of the errors that a fit to n pushes assumes [m]."""
    return float(np.interp(n, (FEW, MANY), (NOISE_OF_FEW, NOISE_OF_MANY)))


def rung(n: int) -> int:
    """Return the largest number of `LADDER` that is at most n."""
    return max(k for k in LADDER if k <= n)


def judged_pushes(groups: Groups, parts: int) -> int:
    """Return the largest number of `LADDER` after which enough parts can be left out."""

    def judging(k: int) -> set[str]:
        return {part for (_, part), own in groups.items() if _enough(len(own), k)}

    return max((k for k in LADDER if len(judging(k)) >= parts), default=0)


def _enough(n: int, pushes: int) -> bool:
    """Whether one half of n pushes has a number of them, and the other half enough to judge."""
    return n // 2 >= pushes and n - n // 2 >= min(10, pushes)


def leave_parts_out(
    groups: Groups,
    fits: Sequence[fit.PartValues],
    share: float,
    pushes: int = 0,
    *,
    chosen: bool = False,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> LeftOutEnds:
    """Predict every part from the others, after a number of its own pushes.

    The own pushes are from one half of them, at random or `chosen` by `choose_pushes`, while the
    errors are of the other half. Groups that have fewer pushes than these and ten more are left
    out. For the share, see `learned_prior`.
    """
    rows: list[tuple[str, str, FloatArray, FloatArray]] = []
    for done, ((surface, part), group) in enumerate(groups.items()):
        pool, test = halves(len(group), seed)
        if _enough(len(group), pushes):
            prior = fit.learned_prior([own for own in fits if own.part != part], surface, share)
            if pushes:
                use = chosen_order(group, pool, prior, pushes) if chosen else pool[:pushes]
                prior = after(group, use, prior)
            test = np.sort(test[:MAX_TEST])
            features, ends, good = fit.bound_features(group, test, prior)
            errors = np.where(good[:, None], group.errors(test, ends), np.inf)
            rows.append((part, f"{surface} {part}".strip(), features, errors))
        if progress is not None:
            progress(done + 1, len(groups), part)
    return LeftOutEnds(
        pushes=pushes,
        part=tuple(part for part, _, _, own in rows for _ in own),
        group=tuple(name for _, name, _, own in rows for _ in own),
        features=np.concatenate([own for _, _, own, _ in rows]) if rows else np.zeros((0, 0)),
        errors=np.concatenate([own for _, _, _, own in rows]) if rows else np.zeros((0, 2)),
    )


def chosen_order(
    group: fit.PartPushes, pool: IntArray, prior: fit.SupportPrior, n: int
) -> IntArray:
    """Return the n pushes (n,) of a pool that `choose_pushes` makes first."""
    pool = np.sort(pool)
    table = fit.slopes(group, pool, prior)
    return np.asarray(pool[fit.choose_pushes(table, table, n)[0]])


def after(
    group: fit.PartPushes, which: IntArray, prior: fit.SupportPrior, repeated: float = 1.0
) -> fit.SupportPrior:
    """Return the distribution of the parameters after pushes `which` (k,) of a part.

    Each is believed as far as its end is certain; repeated ones count as one.
    """
    sizes = fit.errors_of(fit.slopes(group, which, prior), noise_of(round(len(which) / repeated)))
    return fit.fit_part(group, which, prior, float(np.sqrt(repeated)) * sizes)


def halves(n: int, seed: int) -> tuple[IntArray, IntArray]:
    """Return a random half of n pushes to learn from, in random order, and the other half."""
    order = np.random.default_rng(seed).permutation(n)
    return order[: n // 2], order[n // 2 :]


def best_share(groups: Groups, fits: Sequence[fit.PartValues], seed: int = 0) -> float:
    """Return the weight of the others' mean load that predicts parts best that are left out.

    Compared are mean errors, with equal weight of all groups; angles count by their length.
    """
    costs = []
    for share in SHARES:
        total = []
        for (surface, part), group in groups.items():
            prior = fit.learned_prior([own for own in fits if own.part != part], surface, share)
            test = np.sort(halves(len(group), seed)[1][:MAX_TEST])
            ends, good = fit.simulated(group, test, prior.best[None])
            total.append(group.distance(test, ends[0], good[0]))
        costs.append(float(np.mean(total)))
    return SHARES[int(np.argmin(costs))]
