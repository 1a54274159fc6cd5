"""Friction and impacts never add energy; bodies left alone keep momentum."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.laws.scenes import kinetic_energy, scenes

from fixel.model import Body, Disk, Fixel, NoSupport, Scene
from fixel.simulation import Adaptive, Midpoint, StewartTrinkle, simulate

STEPPERS = st.sampled_from([StewartTrinkle(step=1e-3), Midpoint(step=1e-3), Adaptive()])


@given(scene=scenes(drive=False, thrown=True, none=True), stepper=STEPPERS)
@settings(max_examples=60)
def test_friction_never_adds_kinetic_energy(scene, stepper):
    run = simulate(scene, stepper=stepper)
    assert run.converged
    energy = kinetic_energy(scene, run)
    # A step that ends in a corner is a first-order mistake, whose gap is pushed open in the next
    # one; that push may cost energy of the order of the step squared.
    assert np.diff(energy).max() <= 1e-4 * energy[0]
    assert energy.max() <= energy[0] * (1 + 1e-4)


@given(scene=scenes(drive=False, thrown=True, none=True, e=True), stepper=STEPPERS)
@settings(max_examples=60)
def test_newtons_restitution_never_adds_kinetic_energy_without_friction(scene, stepper):
    run = simulate(scene, stepper=stepper)
    assert run.converged
    energy = kinetic_energy(scene, run)
    assert np.diff(energy).max() <= 1e-4 * energy[0]


@given(
    scene=scenes(drive=False, thrown=True, e=True),
    stepper=STEPPERS,
    friction=st.sampled_from([0, 1]),
)
@settings(max_examples=40)
def test_free_bodies_keep_momentum(scene, stepper, friction):
    entry = replace(scene.contact_friction[0], friction=0.5 * friction)
    bodies = tuple(replace(b, support=NoSupport()) for b in scene.bodies)
    free = replace(scene, bodies=bodies, fixels=(), contact_friction=(entry,), duration=1.0)
    run = simulate(free, stepper=stepper)
    assert run.converged
    mass = np.array([b.mass for b in bodies])
    total = sum(m * run.twist[b.name][:, :2] for m, b in zip(mass, bodies, strict=True))
    scale = sum(m * np.hypot(*b.velocity[:2]) for m, b in zip(mass, bodies, strict=True))
    # Each step's momentum rows are met to 1e-9 in scaled units.
    assert np.abs(total - total[0]).max() <= 1e-8 * scale + 1e-15


@pytest.mark.parametrize(
    "stepper", [StewartTrinkle(step=1e-3), Midpoint(step=1e-3), Adaptive()], ids=str
)
def test_a_wall_takes_up_the_momentum_of_what_presses_on_it(stepper):
    # Thrown at the wall at 0.3 m/s, 5 mm away, and pushed by 2 N all the while.
    body = Body(
        name="block",
        shape=Disk(0.02),
        mass=0.2,
        pose=(0, 0, 0),
        velocity=(0.3, 0, 0),
        support=NoSupport(),
        force=(2, 0, 0),
    )
    wall = Fixel(name="wall", shape=Disk(0.01), pose=(0.035, 0, 0), friction=0.0)
    run = simulate(Scene(bodies=(body,), fixels=(wall,), duration=0.4), stepper=stepper)

    taken = float((run.contacts["normal_force"] * run.contacts["step"]).sum())

    assert run.converged
    left = 0.2 * float(run.twist["block"][-1][0])
    assert taken == pytest.approx(0.2 * 0.3 + 2 * 0.4 - left, rel=1e-3)
