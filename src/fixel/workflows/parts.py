"""Learn from pushed parts how a part stands on a surface, to predict parts that were not pushed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.calibration.known_pushes import PARTS, SURFACES, check_conditions
from fixel.calibration.target import target_of
from fixel.datasets import Experiments
from fixel.domain.error_bound import LEVEL
from fixel.errors import InvalidInput
from fixel.io.array_bytes import ResultCache, listed
from fixel.model import Experiment
from fixel.parts.fit import UNPUSHED, PartPushes, PartValues, SupportPrior, fit_part
from fixel.parts.left_out import NOISE_OF_MANY, best_share, leave_parts_out
from fixel.parts.model import PartModel, grouped
from fixel.progress import ProgressOption, show_progress

# Pushes that one fit uses: twelve values need no more, and time grows with them.
MAX_FIT: Final = 125


def part_model(
    experiments: Iterable[Experiment],
    *,
    part: str | None = None,
    surface: str | None = None,
    level: float = LEVEL,
    seed: int = 0,
    threads: int | None = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> PartModel:
    """Learn from pushes of several parts to predict parts that have hardly been pushed.

    For every part on every surface twelve numbers are fitted: friction at the pusher, shift of the
    tracker, size of the tip, bends of the table, and balanced loads under the part. What they have
    in common, and how much they differ, is the prior of a new part. Bounds come from leaving whole
    parts out.

    Parameters
    ----------
    experiments : sequence of Experiment
        Pushes of single parts by a round pusher, slow enough to be quasi-static. Experiments
        without a scene are left out.
    part : str, optional
        Condition that names the part; by default the first of `shape`, `part`, `object` and
        `object_id` that the experiments have.
    surface : str, optional
        Condition that names the surface; by default the first of `surface` and `table`.
    level : float
        Probability of the bounds.
    seed : int
        Seed of the pushes that are fitted and of those that judge.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder for finished fits, so that an interrupted call continues.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    PartModel
        `.at(scene)` predicts a push, `.after(pushes)` learns from pushes of the new part,
        `.next_pushes(candidates)` proposes the next ones.

    Raises
    ------
    InvalidInput
        No experiment has a scene, there is no condition that names the part, or a scene has
        several parts or pushers.

    Examples
    --------
    >>> from fixel.testing.pushes import example_parts
    >>> model = part_model(example_parts(3), progress=False)
    >>> model.parts
    ('part-1', 'part-2', 'part-3')
    >>> round(model.proved_level, 2)
    0.75
    """
    used, part, surface = pushes_of_parts(experiments, part, surface)
    targets = [target_of(own) for own in used]
    named = [own._replace(conditions={part: "", surface: "", **own.conditions}) for own in targets]
    groups = grouped(named, surface, part, threads)
    cache = ResultCache(store)
    fits = []
    with show_progress(progress, "fitting parts") as report:
        for done, ((on, name), group) in enumerate(groups.items()):
            fits.append(PartValues(name, on, *fitted_values(group, seed, cache, f"{on}_{name}")))
            report(done + 1, len(groups), name)
    share = best_share(groups, fits, seed)
    with show_progress(progress, "leaving parts out") as report:
        left_out = leave_parts_out(groups, fits, share, seed=seed, progress=report)
    return PartModel(
        experiments=used,
        part=part,
        surface=surface,
        fits=tuple(fits),
        share=share,
        left_out=left_out,
        level=level,
        seed=seed,
        threads=threads,
    )


def pushes_of_parts(
    experiments: Iterable[Experiment], part: str | None, surface: str | None
) -> tuple[tuple[Experiment, ...], str, str]:
    """Return experiments with a scene, and the conditions that name their part and surface."""
    used = tuple(own for own in Experiments.of(experiments) if own.scene is not None)
    if not used:
        expected, hint = "pushes of parts", "fixel.read_experiments(folder) reads them"
        raise InvalidInput("experiments", found="none with a scene", expected=expected, hint=hint)
    check_conditions(used, part=part, surface=surface)
    return used, part or _condition(used, PARTS, "part"), surface or _condition(used, SURFACES, "")


def fitted_values(group: PartPushes, seed: int, cache: ResultCache, name: str) -> list[np.ndarray]:
    """Return the values fitted to a part on a surface, and their covariance."""
    which = np.sort(np.random.default_rng(seed).permutation(len(group))[:MAX_FIT])

    def compute() -> dict[str, Any]:
        found = fit_part(group, which, SupportPrior.unpushed(), np.full(len(which), NOISE_OF_MANY))
        return {"values": listed(found.mean), "covariance": found.covariance.tolist()}

    of = [group.start[which], group.end[which], group.tip_start[which], group.tip_end[which]]
    uneven = group.cases[0].scene.plane.load_map
    of += [] if uneven is None else [uneven.origin, uneven.cell, uneven.log_load]
    outline = getattr(group.body.shape, "outline", group.radius)
    found = cache.get(name, [*of, outline, repr(UNPUSHED), NOISE_OF_MANY, "covariance"], compute)
    return [np.array(found[own], np.float64) for own in ("values", "covariance")]


def _condition(experiments: tuple[Experiment, ...], names: tuple[str, ...], needed: str) -> str:
    """Return the first name that all experiments have among their conditions."""
    for name in names:
        if all(name in own.conditions for own in experiments):
            return name
    if needed:
        have = ", ".join(sorted({name for own in experiments for name in own.conditions}))
        found = "no condition that names the part of every experiment"
        hint = f"name it: {needed}=...; the experiments have {have or 'none'}"
        expected = "one of " + ", ".join(names)
        raise InvalidInput(needed, found=found, expected=expected, hint=hint)
    return names[0]
