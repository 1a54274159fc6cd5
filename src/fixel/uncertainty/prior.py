"""Prior distributions of unknowns: uniform within their bounds, or normal if a prior is
given."""

from __future__ import annotations

import numpy as np

from fixel.model.space import ParameterSpace
from fixel.typing import FloatArray
from fixel.uncertainty.discrepancy import LABEL, ModelError


class ParameterPrior:
    """Independent priors of the free unknowns of a space, and of model error if it is unknown.

    Parameters
    ----------
    space : ParameterSpace
        An unknown with a `prior` is normal about its nominal value, truncated at its bounds; one
        without is uniform within its bounds.
    model_error : ModelError, optional
        Adds the standard deviation of model error as the last unknown.
    """

    def __init__(self, space: ParameterSpace, model_error: ModelError | None = None) -> None:
        self.space = space
        self.model_error = model_error
        self._sd = np.array([np.inf if u.prior is None else u.prior for u in space.free])

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        more = () if self.model_error is None else (LABEL,)
        return (*self.space.labels, *more)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknowns."""
        more = () if self.model_error is None else ("m",)
        return (*(u.unit for u in self.space.free), *more)

    @property
    def low(self) -> FloatArray:
        """Lower bounds (n,)."""
        more = [] if self.model_error is None else [self.model_error.low]
        return np.array([*self.space.low, *more])

    @property
    def high(self) -> FloatArray:
        """Upper bounds (n,)."""
        more = [] if self.model_error is None else [self.model_error.high]
        return np.array([*self.space.high, *more])

    def transform(self, unit: FloatArray) -> FloatArray:
        """Return the values (k, n) at probabilities (k, n) in [0, 1]."""
        from scipy.special import ndtr, ndtri

        n = len(self._sd)
        low, high, mean = self.space.low, self.space.high, self.space.nominal
        q = np.asarray(unit, np.float64)[:, :n]
        values = low + q * (high - low)
        known = np.isfinite(self._sd)
        if known.any():
            sd = self._sd[known]
            ends = ndtr((np.stack((low, high))[:, known] - mean[known]) / sd)
            inner = ends[0] + q[:, known] * (ends[1] - ends[0])
            values[:, known] = np.clip(mean[known] + sd * ndtri(inner), low[known], high[known])
        if self.model_error is None:
            return np.asarray(values)
        return np.column_stack((values, self.model_error.transform(unit[:, n])))

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw points (count, n) from the prior."""
        return self.transform(rng.random((count, len(self.labels))))
