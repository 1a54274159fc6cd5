"""Nothing in a scene without drives and forces may gain kinetic energy: any stepper, any solver."""

import numpy as np
import pytest
from tests.laws.scenes import kinetic_energy

from fixel.model import (
    Body,
    Disk,
    Fixel,
    NoSupport,
    PairFriction,
    Polygon,
    Scene,
    Tripod,
    UniformPressure,
)
from fixel.simulation import (
    Adaptive,
    Dynamic,
    GaussSeidel,
    Lemke,
    Midpoint,
    Newton,
    StewartTrinkle,
    simulate,
)
from fixel.testing.scenes import box, row


def _shape(rng, size):
    kind = rng.integers(4)
    if kind == 0:
        return Disk(size)
    if kind == 1:
        return box(size * rng.uniform(0.4, 1.4), size * rng.uniform(0.4, 1.4))
    if kind == 2:
        return box(1.9 * size, size * 10.0 ** rng.uniform(-2.0, -0.5))
    n = int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / n
    return Polygon(size * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def _support(rng, size):
    friction = rng.choice([0.0, rng.uniform(0.0, 1.0)])
    kind = rng.integers(3)
    if kind == 0:
        return Tripod(radius=size * rng.uniform(0.1, 0.6), friction=friction)
    return UniformPressure(friction=friction, n_points=9) if kind == 1 else NoSupport()


def passive_scene(seed: int):
    """Bodies thrown about among walls and pegs, in sizes from micrometres to metres."""
    rng = np.random.default_rng([41, seed])
    size = 10.0 ** rng.uniform(-5.0, 0.5)
    speed = size * 10.0 ** rng.uniform(-1.0, 2.0)
    friction = rng.choice([0.0, rng.uniform(0.0, 1.2), 5.0])
    restitution = rng.choice([0.0, 0.0, rng.uniform(0.0, 1.0), 1.0])
    bodies = []
    n = int(rng.integers(1, 5))
    for k in range(n):
        own = size * rng.uniform(0.3, 1.0)
        bodies.append(
            Body(
                name=f"body-{k}",
                shape=_shape(rng, own),
                mass=10.0 ** rng.uniform(-2.0, 0.0),
                pose=row(2.1 * size * (k % 2), 2.1 * size * (k // 2), rng.uniform(-3.0, 3.0)),
                velocity=row(*(speed * rng.normal(size=2)), speed / own * rng.normal()),
                support=_support(rng, own),
            )
        )
    places = [(-1.6, 1.0), (3.7, 1.0), (1.0, -1.6), (1.0, 3.7)]
    fixels = [
        Fixel(
            name=f"wall-{k}",
            shape=Disk(0.4 * size) if rng.random() < 0.4 else box(0.5 * size, 3.0 * size),
            pose=row(size * x, size * y, k // 2 * np.pi / 2 + rng.uniform(-0.05, 0.05)),
            friction=friction,
            restitution=restitution,
        )
        for k, (x, y) in enumerate(places)
        if rng.random() < 0.8
    ]
    entry = PairFriction(pair=("body-*", "body-*"), friction=friction, restitution=restitution)
    solver = [Newton(), Newton(), GaussSeidel(), Lemke()][rng.integers(4)]
    duration = 6.0 * size / speed
    stepper = [
        Adaptive(max_steps=2000),
        Adaptive(tolerance=1e-7 * size, max_steps=2000),
        StewartTrinkle(step=duration / 100),
        Midpoint(step=duration / 100),
    ][rng.integers(4)]
    scene = Scene(
        bodies=bodies,
        fixels=fixels,
        contact_friction=(entry,),
        duration=duration,
        support_directions=8 if isinstance(solver, Lemke) else None,
    )
    return scene, stepper, solver


def _check(seed: int) -> None:
    scene, stepper, solver = passive_scene(seed)
    run = simulate(scene, motion=Dynamic(), stepper=stepper, solver=solver)
    energy = kinetic_energy(scene, run)
    # Each step's rows are met to 1e-9 of the characteristic momentum.
    assert np.diff(energy).max(initial=0.0) <= 1e-6 * energy[0]
    assert energy.max() <= (1.0 + 1e-6) * energy[0]


@pytest.mark.parametrize("seed", range(40))
def test_passive_scenes_gain_no_energy(seed):
    _check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(1000, 4000, 100))
def test_thousands_of_passive_scenes_gain_no_energy(first):
    for seed in range(first, first + 100):
        _check(seed)
