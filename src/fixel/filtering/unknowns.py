"""Unknowns of a particle, constant during a run, as numbers without bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from fixel.filtering.prior import UniformPrior
from fixel.typing import BoolArray, FloatArray

N_POSE: Final = 3
N_NORMAL: Final = N_POSE
TREMBLE: Final = 1e-3  # [-] of a proposal, where two particles are the same
# Model error in one frame of 1/30 s [m], from what no camera sees in a run to what carries the
# object wherever the camera sees it. The least with the probability that the model is right;
# otherwise the logarithm is uniform in between.
MIN_WALK: Final = 3e-6
MAX_WALK: Final = 5e-4
RIGHT: Final = 0.5  # [-]


@final
@dataclass(frozen=True, slots=True)
class Unknowns:
    """Parameters, start pose and model error of a particle, and the belief about them.

    One row of numbers on the *free* scale for each particle: the parameters
    (`UniformPrior.free`), the start pose in standard deviations from its centre, and the
    logarithm of the model error, stretched like a parameter.

    Attributes
    ----------
    prior : UniformPrior
    centre : (3,) float64
        Of the start pose [m, m, rad].
    deviation : (3,) float64
        Of the start pose [m, m, rad].
    """

    prior: UniformPrior
    centre: FloatArray
    deviation: FloatArray

    @property
    def size(self) -> int:
        """Number of unknowns of one particle."""
        return len(self.prior.names) + N_NORMAL + 1

    def drawn(self, n: int, random: np.random.Generator) -> FloatArray:
        """(n, size) draws from the belief."""
        free = np.empty((n, self.size))
        free[:, : -N_NORMAL - 1] = self.prior.free(self.prior.drawn(n, random))
        free[:, -N_NORMAL - 1 : -1] = random.standard_normal((n, N_NORMAL))
        free[:, -1] = random.logistic(size=n)
        return free

    def values(self, free: FloatArray) -> FloatArray:
        """(n, n_name) parameters."""
        return self.prior.bounded(free[:, : -N_NORMAL - 1])

    def columns(self, free: FloatArray) -> dict[str, FloatArray]:
        """Parameters by name, as a batch takes them."""
        return self.prior.columns(self.values(free))

    def start(self, free: FloatArray) -> FloatArray:
        """(n, 3) start poses [m, m, rad]."""
        first = len(self.prior.names)
        return self.centre + free[:, first : first + N_POSE] * self.deviation

    def walk(self, free: FloatArray) -> FloatArray:
        """(n,) standard deviations of the model error in one frame [m]."""
        place = 0.5 * (1.0 + np.tanh(0.5 * free[:, -1]))  # uniform from 0 to 1
        share = np.maximum(0.0, place - RIGHT) / (1.0 - RIGHT)
        return np.asarray(MIN_WALK * (MAX_WALK / MIN_WALK) ** share)

    def log_density(self, free: FloatArray) -> FloatArray:
        """(n, size) logarithms of the belief's density on the free scale, up to constants."""
        stretched = np.abs(free)
        found = -stretched - 2.0 * np.log1p(np.exp(-stretched))
        normal = np.s_[:, -N_NORMAL - 1 : -1]
        found[normal] = -0.5 * free[normal] ** 2
        return np.asarray(found)

    def proposed(
        self,
        free: FloatArray,
        weight: FloatArray,
        depends: FloatArray,
        random: np.random.Generator,
    ) -> tuple[FloatArray, FloatArray]:
        """Return a new place for every particle.

        It goes along the difference of two others: such steps have the spread of the particles
        themselves. Some of the unknowns stay where they are, and every tenth step is a whole
        difference, which can reach another peak. Parameters are drawn again from the belief where
        no path depends on them; a quarter of the places have one unknown drawn again.

        Parameters
        ----------
        free : (n, size) float64
        weight : (n,) float64
            How often a particle is one of the two.
        depends : (n_name,) float64
            Share of the particles whose path depends on each parameter [-].
        random : numpy.random.Generator

        Returns
        -------
        free : (n, size) float64
        prior : (n,) float64
            Logarithm of the belief's density there over that here, less what the draws make up for.

        Source: ter Braak (2006), A Markov chain Monte Carlo version of the genetic algorithm
        differential evolution.
        """
        n, size = free.shape
        one, other = (random.choice(n, n, p=weight) for _ in range(2))
        moved = random.random((n, size)) < random.choice([0.35, 0.7, 1.0], n)[:, None]
        whole = random.random(n) < 0.1
        scale = np.where(whole, 1.0, 2.38 / np.sqrt(2.0 * np.maximum(moved.sum(axis=1), 1)))
        scale *= random.uniform(0.6, 1.1, n)
        step = scale[:, None] * (free[one] - free[other]) + TREMBLE * random.standard_normal(
            (n, size)
        )
        there = free + np.where(moved, step, 0.0)
        drawn = np.asarray(random.integers(0, size, n))[:, None] == np.arange(size)
        drawn &= random.random((n, 1)) < 0.25
        drawn[:, : len(depends)] |= random.random((n, len(depends))) >= depends
        there = np.where(drawn, self.drawn(n, random), there)
        prior = self.log_density(there) - self.log_density(free)
        return there, np.sum(np.where(drawn, 0.0, prior), axis=1)


def accepted(ratio: FloatArray, random: np.random.Generator) -> BoolArray:
    """(n,) which moves are made by Metropolis' rule, from logarithms of ratios of densities."""
    return np.asarray(np.log(random.random(len(ratio))) < ratio)
