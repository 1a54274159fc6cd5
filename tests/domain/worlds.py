"""Made-up evidence whose truth is known."""

import numpy as np

from fixel.domain.evidence import HeldOutErrors

STEPS = np.linspace(-0.04, 0.04, 11)


def evidence_of(errors_mm, coordinates, **more):
    """Errors of experiments at these coordinates, each an array."""
    n = len(errors_mm)
    return HeldOutErrors(
        keys=tuple(f"lab/{k}" for k in range(n)), ids=tuple(range(1, n + 1)),
        coordinates={name: tuple(np.asarray(x).tolist()) for name, x in coordinates.items()},
        error_mm2=np.square(errors_mm), **more,
    )  # fmt: skip


def line(errors_mm, steps=STEPS, repetitions=1, **changes):
    """One map along offset_y_m: an error a step, each repeated."""
    every = np.repeat(steps, repetitions)
    rms = np.asarray(errors_mm, float)
    rms = np.repeat(rms, repetitions) if len(rms) == len(steps) else rms
    settings = {"configuration": tuple(f"{y:g}" for y in every)} | changes
    return evidence_of(rms, {"offset_y_m": every}, **settings)


def scattered(maps=8, members=2, scatter=0.15, seed=0):
    """Several maps with smooth errors and members that scatter about them, and the quantile that
    90 % of further members stay below [mm], (n_map, n_cell)."""
    from scipy.special import ndtri

    rng = np.random.default_rng(seed)
    y, group, error, truth = [], [], [], []
    for g in range(maps):
        slope, bend, level = rng.normal(0, 12.0), rng.normal(0, 500.0), rng.normal(0.7, 0.3)
        middle = level + slope * STEPS + bend * STEPS**2 + rng.normal(0, 0.3, len(STEPS))
        truth.append(np.exp(middle + ndtri(0.9) * scatter))
        for k, step in enumerate(STEPS):
            for _ in range(members):
                y.append(float(step))
                group.append(f"map {g}")
                error.append(np.exp(middle[k] + scatter * rng.normal()))
    return evidence_of(error, {"offset_y_m": y}, group=tuple(group)), np.array(truth)
