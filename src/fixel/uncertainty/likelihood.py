"""Log likelihood of measured paths given parameters, computed for batches of points.

A measured frame is the sum of the simulated one, the model error (`error_terms.py`) and the
camera noise. Both are Gaussian, so the probability of a whole path is a product over the
principal axes of the random walk of the model error:

    log p = sum over axes i, channels c of log N(z_ic; 0, T s_c^2 + tau_c^2 w_i)

with z the residuals along the axes, w the variances of the walk, s the noise, T its correlation:
N correlated frames count as N / T independent ones (docs/theory/identifiability.md). The error of a
measured start is common to all frames of an experiment; it adds a covariance of rank three.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from fixel.calibration.honest import MM, STARTS, ShiftModel
from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.noise import Noise, second_differences
from fixel.calibration.objective import Comparer
from fixel.calibration.optimiser import SearchBox
from fixel.errors import InvalidInput
from fixel.model.space import ParameterSpace
from fixel.model.trajectory import wrapped
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.error_terms import LABEL, ModelError, log_density, shares_of_way, walk_over

# Log likelihood of a failed simulation: finite, but practically impossible for dynesty.
FLOOR: Final = -1e300

# Maximum number of rollouts whose differences are in memory at a time.
MAX_ROLLOUTS: Final = 4096

# Maximum number of frames per experiment; of more, every second, third, ... from the last is used.
MAX_FRAMES: Final = 400

# Fit of measured starts with the parameters, and number of experiments that are fitted together:
# its cost grows with the square of that number.
TOGETHER: Final = 10
START_FIT: Final = LeastSquares(
    loss="soft_l1", width=3.0, differences="central", difference=0.2, most_iterations=30
)

# Standard deviation over the median absolute value of a normal variable.
_SD_OF_MEDIAN: Final = 1.4826


class ParameterPrior:
    """Independent priors of the free unknowns of a space, and of model error if it is unknown.

    An unknown with a `prior` is normal about its nominal value, truncated at its bounds; one
    without is uniform within its bounds. Model error adds its standard deviation as the last
    unknown.
    """

    def __init__(self, space: ParameterSpace, model_error: ModelError | None = None) -> None:
        self.space = space
        self.model_error = model_error
        self._sd = np.array([np.inf if u.prior is None else u.prior for u in space.free])
        more = [] if model_error is None else [model_error]
        # Names and units of the unknowns.
        self.labels = (*space.labels, *(LABEL for _ in more))
        self.units = (*(u.unit for u in space.free), *("m" for _ in more))
        # Bounds.
        self.low = np.array([*space.low, *(error.low for error in more)])
        self.high = np.array([*space.high, *(error.high for error in more)])

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


class LogLikelihood:
    """Log likelihood of points for one or several members of a comparer.

    The noise is that of the camera alone if model error is given; else of all unexplained
    deviations. The standard deviation of model error becomes the last unknown and is the same for
    all experiments; their errors are independent. Points are counted in `evaluations`, and those
    for which an experiment could not be simulated in `failed`.
    """

    def __init__(
        self,
        comparer: Comparer,
        members: Sequence[int],
        noise: Noise,
        model_error: ModelError | None = None,
    ) -> None:
        self.comparer = comparer
        self.members = np.asarray(members, np.int64)
        if not len(self.members):
            raise InvalidInput("experiments", found="none", expected="at least one")
        self.noise = noise
        self.prior = ParameterPrior(comparer.space, model_error)
        self.evaluations = self.failed = 0
        length = comparer.length(self.members)
        self._seen = [_seen(int(n)) for n in length]
        # Of frames that are farther apart, fewer count as one.
        correlation = np.maximum(1.0, noise.correlation / np.ceil(length / MAX_FRAMES))
        self._white = correlation[:, None] * noise.standard_deviations**2
        known = range(0 if model_error is None else len(self.members))
        self._walks = [walk_over(self.shares(k)[self._seen[k]]) for k in known]
        # Unknowns of the simulations: columns of the parameters, and values of the others.
        self._simulated, self._columns = comparer, list(range(len(comparer.space.labels)))
        self._base = np.zeros((len(self.members), len(self._columns)))
        self._starts: list[tuple[FloatArray, FloatArray]] = []

    def count_starts(self, point: FloatArray, camera: Noise | None) -> None:
        """Count the noise of the camera in measured starts, unless starts are among the unknowns.

        Starts and parameters are fitted together, from a point (n_free,). Simulations then begin at
        the fitted starts: likely ones are near these, and their effects are almost linear.
        """
        space, n, p = self.comparer.space, len(self.members), len(self._columns)
        measured = [self.comparer.targets[m].starts_measured for m in self.members]
        if not camera or not any(measured) or any(u.name in STARTS for u in space.free):
            return
        shifted = ShiftModel(self.comparer)
        starts = np.array([[shifted.columns[m][name] for name in STARTS] for m in self.members])
        sd = np.outer(measured, camera.standard_deviations)
        instants = [len(shifted.instants[m]) for m in self.members]
        weight = np.sqrt(self.comparer.length(self.members) / instants)
        weight = weight[:, None] / (MM * camera.standard_deviations)
        self._simulated, self._columns = self.comparer.over(shifted.space), shifted.free
        self._base = np.tile(shifted.space.nominal, (n, 1))

        def rows_of(own: IntArray, values: FloatArray, shifts: FloatArray) -> FloatArray:
            """Return points (k, n) of experiments, with starts shifted by standard deviations."""
            rows = self._base[own]
            rows[:, self._columns] = values
            rows[np.arange(len(own))[:, None], starts[own]] += shifts * sd[own]
            return rows

        def residuals(some: IntArray, points: FloatArray) -> FloatArray:
            """Residuals (k, m) of some experiments at points (k, p + 3 n)."""
            k, own = len(points), np.tile(some, len(points))
            rows = rows_of(own, points[:, :p].repeat(len(some), 0), points[:, p:].reshape(-1, 3))
            found = shifted.differences(np.column_stack((self.members[own], rows)))
            return (found.reshape(len(own), 3, -1) * weight[own, :, None]).reshape(k, -1)

        values, shifts = np.zeros((n, p)), np.zeros((n, 3))
        for some in np.array_split(np.arange(n), math.ceil(n / TOGETHER)):
            end = np.full(3 * len(some), 4.0)  # standard deviations
            low, high = np.append(space.low, -end), np.append(space.high, end)
            scale = np.append(0.05 * space.scale, np.ones(end.size))
            box = SearchBox(low, high, np.append(point, 0.0 * end), scale)
            prior = NormalPrior(mean=box.start, sd=np.append(np.full(p, math.inf), end / 4.0))
            best = fit(START_FIT.start(box, prior=prior), partial(residuals, some)).point
            values[some], shifts[some] = best[:p], best[p:].reshape(-1, 3)
        # The change by a standard deviation, from half of it to either side.
        own = np.repeat(np.arange(n), 6)
        sides = np.tile(np.kron(np.eye(3), [[0.5], [-0.5]]), (n, 1))
        rows = rows_of(own, values[own], shifts[own] + sides)
        found, good, _ = self._simulated.differences(self.members[own], rows)
        found = found.reshape(n, 3, 2, -1, 3)
        change = np.moveaxis(found[:, :, 0] - found[:, :, 1], 1, -1)
        change[~good.reshape(n, 6).all(axis=1)] = 0.0  # beside an overlap
        self._base[np.arange(n)[:, None], starts] += shifts * sd
        for k, seen in enumerate(self._seen):
            each = change[k, seen]
            if self._walks:  # along the axes
                each = np.einsum("mi,mcp->icp", self._walks[k][0], each)
            self._starts.append((each, each @ shifts[k]))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Return (k,) values at points (k, n); `FLOOR` where an experiment cannot be simulated."""
        table = np.ascontiguousarray(points, np.float64)
        most = max(1, MAX_ROLLOUTS // len(self.members))
        parts = [self._some(table[k : k + most]) for k in range(0, len(table), most)]
        found = np.concatenate(parts) if parts else np.zeros(0)
        self.evaluations += len(found)
        self.failed += int((found <= FLOOR).sum())
        return found

    def _some(self, points: FloatArray) -> FloatArray:
        """Return (k,) values at a few points, computed in one batch with all experiments."""
        k, n = len(points), len(self.members)
        rows = np.repeat(self._base, k, axis=0)
        rows[:, self._columns] = np.tile(points[:, : len(self._columns)], (n, 1))
        difference, good, _ = self._simulated.differences(np.repeat(self.members, k), rows)
        error = self.prior.model_error
        tau = np.zeros((k, 3)) if error is None else np.asarray(points[:, -1:] / error.sides)
        total = np.zeros(k)
        for own in range(n):
            total += self._one(own, difference[own * k : (own + 1) * k, self._seen[own]], tau)
        fine = good.reshape(n, k).all(axis=0) & np.isfinite(total)
        return np.where(fine, np.maximum(total, FLOOR), FLOOR)

    def _one(self, own: int, difference: FloatArray, tau: FloatArray) -> FloatArray:
        """Return the log likelihood (k,) of one experiment from residuals (k, n_seen, 3)."""
        white, variance = self._white[own], np.zeros(difference.shape[1])
        if not self._walks and not self._starts:
            scale = difference.shape[1] * float(np.log(2.0 * math.pi * white).sum())
            return np.asarray(-0.5 * (np.sum(difference**2 / white, axis=(1, 2)) + scale))
        if self._walks:
            axes, variance = self._walks[own]
            # (n, n) x (n, 3) for each point: bit for bit the same, whatever the size of the batch.
            difference = np.matmul(axes.T, difference)
        if not self._starts:
            return log_density(difference, variance, tau, white)
        change, mean = self._starts[own]
        return log_density(difference - mean, variance, tau, white, change)

    def shares(self, own: int) -> FloatArray:
        """Return the shares of the way (n_sample,) of one experiment, by its index in `members`."""
        error = self.prior.model_error or ModelError()
        return expected_shares(self.comparer, int(self.members[own]), error)


def expected_shares(
    comparer: Comparer, member: int, error: ModelError, path: FloatArray | None = None
) -> FloatArray:
    """Return the share (n_sample,) of the way travelled up to each frame of an experiment.

    It is the mean of the shares of the simulation at nominal values and of the measured poses, or
    of a `path` (n_sample, 3) instead of these. The first alone would allow no model error where the
    object still moves but the simulation is at rest. With the second alone, the prior would depend
    on the data.
    """
    target = comparer.targets[member]
    start = target.case.scene.bodies[0].pose
    difference, good, _ = comparer.differences(
        np.array([member]), comparer.space.nominal[None].copy()
    )
    nominal = target.pose + difference[0, : len(target.pose)]
    shares = []
    way = (target.pose if path is None else path).copy()
    for poses in [way, *([nominal] if good[0] else [])]:
        poses[:, 2] = start[2] + wrapped(poses[:, 2] - start[2])
        shares.append(shares_of_way(start, poses, error.angle_scale))
    return np.asarray(np.mean(shares, axis=0))


def camera_noise(comparer: Comparer, members: Sequence[int], point: FloatArray) -> Noise:
    """Estimate the noise of the camera from the differences of residuals between frames.

    Second differences of white noise have six times its variance; those of a smooth model error are
    almost zero. The median absolute value ignores frames in which a contact closed or opened. The
    residuals are those of a point (n_free,); a rough fit is sufficient.
    """
    points = np.repeat(np.asarray(point, np.float64)[None], len(members), axis=0)
    residuals, good, _ = comparer.differences(np.asarray(members), points)
    rows: list[FloatArray] = []
    for member, own, ok in zip(members, residuals, good, strict=True):
        target = comparer.targets[member]
        rows += second_differences(target.case.times, own[: len(target.pose)]) if ok else []
    if not rows:
        found = "no experiment of three frames at even times that could be simulated"
        expected = "an experiment from which the camera noise can be estimated"
        hint = "state the noise: noise=..."
        raise InvalidInput("noise", found=found, expected=expected, hint=hint)
    table = np.concatenate(rows)
    sd = _SD_OF_MEDIAN * np.median(np.abs(table), axis=0) / math.sqrt(6.0)
    position, freedom = float(np.sqrt(np.mean(sd[:2] ** 2))), float(max(1, table.size // 3))
    return Noise.of(position, float(sd[2]), "residuals", freedom=freedom)


def _seen(length: int) -> np.ndarray:
    """Return the indices of the frames that are used."""
    stride = max(1, math.ceil(length / MAX_FRAMES))
    return np.asarray(np.arange(length)[(length - 1 - np.arange(length)) % stride == 0])
