"""How large an error to expect from features, learned from errors that were seen.

None of these has to be right: whatever a promise adds on top is measured on experiments that the
model has not seen. A better model makes bounds sharper, not truer.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from fixel.typing import FloatArray

# Models predict this power of the error: a bound that scales with the error alone would be too wide
# where errors are large, one that adds a length to all of them where they are small.
POWER: Final = 1.0 / 3.0
# Fewer experiments than this give a constant.
MIN_MODEL: Final = 30
TREES: Final = 100
MIN_LEAF: Final = 5
SHARE_OF_FEATURES: Final = 1.0 / 3.0
NEIGHBOURS: Final = 12


class ScaleModel(Protocol):
    """Powers of errors (n,) to expect of features (n, f)."""

    def __call__(self, features: FloatArray, /) -> FloatArray: ...


def powered(errors: FloatArray) -> FloatArray:
    """Errors as models see them."""
    return np.asarray(errors**POWER)


def unpowered(values: FloatArray) -> FloatArray:
    """Errors again; nothing below zero."""
    return np.asarray(np.maximum(values, 0.0) ** (1.0 / POWER))


def usual_model(n: int) -> str:
    """Name of the best model there is for n experiments."""
    if n < MIN_MODEL:
        return "constant"
    try:
        import sklearn  # noqa: F401
    except ImportError:
        return "neighbours"
    return "forest"


def fitted_model(name: str, features: FloatArray, values: FloatArray, seed: int) -> ScaleModel:
    """A model of `values` (n,), finite powers of errors.

    Parameters
    ----------
    name : str
        `"forest"`: extremely randomised trees (Geurts, Ernst & Wehenkel 2006), of scikit-learn.
        `"neighbours"`: the mean of the nearest. `"constant"`: the median.
    """
    if name == "forest":
        return _forest(features, values, seed)
    if name == "neighbours":
        return _Neighbours(Scale.of(features), features, values)
    return _Constant(float(np.median(values)) if len(values) else 0.0)


class Scale(NamedTuple):
    """Centre and spread of columns; those that never vary have none."""

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
