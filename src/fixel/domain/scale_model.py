"""Models of the expected size of errors, learned from features and errors of experiments.

A model need not be correct: the conformal correction of a bound is measured on experiments that
the model has not seen. A better model makes bounds narrower, not more reliable.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from fixel.typing import FloatArray

# Power of the error that models predict: bounds proportional to the error would be too wide for
# large errors, and bounds with a constant addition too wide for small ones.
POWER: Final = 1.0 / 3.0
# Fewer experiments than this give a constant.
MIN_MODEL: Final = 30
TREES: Final = 100
MIN_LEAF: Final = 5
SHARE_OF_FEATURES: Final = 1.0 / 3.0
NEIGHBOURS: Final = 12


class ScaleModel(Protocol):
    """Function from features (n, f) to expected powers of errors (n,)."""

    def __call__(self, features: FloatArray, /) -> FloatArray: ...


def powered(errors: FloatArray) -> FloatArray:
    """Return the powers of errors that models predict."""
    return np.asarray(errors**POWER)


def unpowered(values: FloatArray) -> FloatArray:
    """Inverse of `powered`; negative values count as zero."""
    return np.asarray(np.maximum(values, 0.0) ** (1.0 / POWER))


def default_model(n: int) -> str:
    """Return the name of the best available model for n experiments."""
    if n < MIN_MODEL:
        return "constant"
    try:
        import sklearn  # noqa: F401
    except ImportError:
        return "neighbours"
    return "forest"


def fitted_model(name: str, features: FloatArray, values: FloatArray, seed: int) -> ScaleModel:
    """Fit a model to `values` (n,), finite powers of errors.

    Parameters
    ----------
    name : str
        `"forest"`: extremely randomised trees (Geurts, Ernst & Wehenkel 2006), of scikit-learn.
        `"neighbours"`: mean of the nearest experiments. `"constant"`: median.
    """
    if name == "forest":
        return _forest(features, values, seed)
    if name == "neighbours":
        return _Neighbours(Scale.of(features), features, values)
    return _Constant(float(np.median(values)) if len(values) else 0.0)


class Scale(NamedTuple):
    """Standardisation of columns by centre and spread; constant columns are dropped."""

    centre: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, features: FloatArray) -> Scale:
        centre = features.mean(axis=0)
        return cls(centre, features.std(axis=0))

    def __call__(self, features: FloatArray) -> FloatArray:
        used = self.spread > 1e-9 * np.maximum(np.abs(self.centre), 1e-9)
        return np.asarray((features[:, used] - self.centre[used]) / self.spread[used])


class _Constant(NamedTuple):
    value: float

    def __call__(self, features: FloatArray, /) -> FloatArray:
        return np.full(len(features), self.value)


class _Neighbours(NamedTuple):
    scale: Scale
    features: FloatArray
    values: FloatArray

    def __call__(self, features: FloatArray, /) -> FloatArray:
        from scipy.spatial import KDTree

        k = min(NEIGHBOURS, len(self.values))
        tree = KDTree(self.scale(self.features))
        _, near = tree.query(self.scale(features), k=range(1, k + 1))
        return np.asarray(self.values[near].mean(axis=1))


class _Forest(NamedTuple):
    trees: Any

    def __call__(self, features: FloatArray, /) -> FloatArray:
        return np.asarray(self.trees.predict(features), np.float64)


def _forest(features: FloatArray, values: FloatArray, seed: int) -> ScaleModel:
    from sklearn.ensemble import ExtraTreesRegressor

    trees = ExtraTreesRegressor(
        TREES, min_samples_leaf=MIN_LEAF, max_features=SHARE_OF_FEATURES, random_state=seed,
        n_jobs=1,
    )  # fmt: skip
    return _Forest(trees.fit(features, values))
