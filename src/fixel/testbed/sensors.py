"""Simulated measurements of the camera and the fixels from a simulation."""

from __future__ import annotations

import numpy as np

from fixel.model import Channel
from fixel.simulation import Simulation
from fixel.typing import BoolArray, FloatArray

ON_CLOCK = 1e-6  # largest distance of a sample from the clock, in frames [-]


def frames_of(simulation: Simulation, frame_rate: float) -> BoolArray:
    """Return (n_sample,) bool: samples on the camera's clock; the end of a run may be off it."""
    count = simulation.time * frame_rate
    return np.asarray(np.abs(count - np.rint(count)) < ON_CLOCK)


def touching(simulation: Simulation) -> BoolArray:
    """Return (n_sample, n_fixel) bool: whether the body touches the fixel."""
    scene, contacts = simulation.scene, simulation.contacts
    n_moving = len(scene.bodies) + len(scene.pushers)
    fixel = np.maximum(contacts["body"], contacts["other"]) - n_moving
    sample = np.searchsorted(simulation.time, contacts["time"])
    found = np.zeros((len(simulation.time), len(scene.fixels)), np.bool_)
    found[sample[fixel >= 0], fixel[fixel >= 0]] = True
    return found


def frames_kept(n_frame: int, share_dropped: float, random: np.random.Generator) -> BoolArray:
    """Draw (n_frame,) bool: frames that arrive; the first and the last always do."""
    kept = random.random(n_frame) >= share_dropped
    kept[[0, -1]] = True
    return np.asarray(kept)


def seen(
    pose: FloatArray, position_noise: float, angle_noise: float, random: np.random.Generator
) -> FloatArray:
    """Add white noise to poses (n, 3), with standard deviations in [m] and [rad]."""
    return pose + random.standard_normal(pose.shape) * (position_noise, position_noise, angle_noise)


def tactile_channel(
    time: FloatArray,
    touches: BoolArray,
    false_contact: float,
    missed_contact: float,
    random: np.random.Generator,
) -> Channel:
    """Return readings of the fixels with independent errors.

    Parameters
    ----------
    time : (n,) float64
        Times of the readings [s], with those of dropped frames: the fixels have their own line.
    touches : (n, n_fixel) bool
        True contacts.
    false_contact, missed_contact : float
        Probabilities of reading 1 without contact, and 0 with it [-].
    random : numpy.random.Generator
    """
    wrong = random.random(touches.shape) < np.where(touches, missed_contact, false_contact)
    return Channel(
        name="tactile",
        time=time,
        columns=tuple(f"fixel_{k}_bool" for k in range(1, touches.shape[1] + 1)),
        values=np.asarray(touches ^ wrong, np.float64),
    )
