"""Made-up evidence whose truth is known."""

import numpy as np

from fixel.domain.evidence import HeldOutErrors

STEPS = np.linspace(-0.04, 0.04, 11)


def line(errors_mm, steps=STEPS, repetitions=1, **changes):
    """One map along offset_y_m: an error a step, each repeated."""
    every = np.repeat(steps, repetitions)
    rms = np.asarray(errors_mm, float)
    rms = np.repeat(rms, repetitions) if len(rms) == len(steps) else rms
    settings = {
        "keys": tuple(f"lab/{k}" for k in range(len(every))),
        "ids": tuple(range(1, len(every) + 1)),
        "coordinates": {"offset_y_m": tuple(every.tolist())},
        "error_mm2": rms**2,
        "configuration": tuple(f"{y:g}" for y in every),
    } | changes
    return HeldOutErrors(**settings)


def scattered(maps=8, members=2, scatter=0.15, seed=0):
    """Several maps with smooth errors and members that scatter about them, and the quantile that
    90 % of further members stay below [mm], (n_map, n_cell)."""
    from scipy.special import ndtri

    rng = np.random.default_rng(seed)
    keys, y, group, error, truth = [], [], [], [], []
    for g in range(maps):
        slope, bend, level = rng.normal(0, 12.0), rng.normal(0, 500.0), rng.normal(0.7, 0.3)
        middle = level + slope * STEPS + bend * STEPS**2 + rng.normal(0, 0.3, len(STEPS))
        truth.append(np.exp(middle + ndtri(0.9) * scatter))
        for k, step in enumerate(STEPS):
            for r in range(members):
                keys.append(f"lab/{g}-{k}-{r}")
                y.append(float(step))
                group.append(f"map {g}")
                error.append(np.exp(2.0 * (middle[k] + scatter * rng.normal())))
    evidence = HeldOutErrors(
        keys=tuple(keys), ids=tuple(range(len(keys))), coordinates={"offset_y_m": tuple(y)},
        error_mm2=np.array(error), group=tuple(group),
    )  # fmt: skip
    return evidence, np.array(truth)
