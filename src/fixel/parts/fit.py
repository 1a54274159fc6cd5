"""Support parameters of a part: their prior from other parts, fits to pushes, choice of pushes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import Configurations
from fixel.calibration.least_squares import LeastSquares, NormalPrior, fit
from fixel.calibration.objective import ANGLE_SCALE
from fixel.calibration.optimiser import SearchBox
from fixel.calibration.target import Target
from fixel.domain.features import simulated_features
from fixel.errors import InvalidInput
from fixel.model import Disk, PathDrive, Scene, pose_error, rotated, wrapped
from fixel.model.scene import check_push
from fixel.model.shape import length_scale
from fixel.simulation import QuasiStatic, StewartTrinkle
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.pack import pusher_path
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import BoolArray, FloatArray, IntArray


class Marginal(NamedTuple):
    """Prior of one parameter before any part has been pushed."""

    mean: float
    sd: float
    low: float
    high: float
    symmetric: bool = False  # whether its sign means nothing on another part


# Equal loads with the centre of pressure under the centre of mass, on a flat table.
UNPUSHED: Final[Mapping[str, Marginal]] = {
    "mu_pusher": Marginal(0.2, 0.1, 0.02, 0.8),
    "registration_x": Marginal(0.0, 1e-3, -4e-3, 4e-3),
    "registration_y": Marginal(0.0, 1e-3, -4e-3, 4e-3),
    "contact_offset": Marginal(0.0, 0.3e-3, -1e-3, 1e-3),
    "table_bend_xy": Marginal(0.0, 0.6, -2.0, 2.0),
    "table_bend_diagonal": Marginal(0.0, 0.6, -2.0, 2.0),
    "pressure_rim": Marginal(0.0, 1.5, -6.0, 6.0),
    "pressure_corner": Marginal(0.0, 1.0, -3.0, 3.0),
    "pressure_xy": Marginal(0.0, 1.0, -3.0, 3.0),
    "pressure_diagonal": Marginal(0.0, 1.0, -3.0, 3.0, symmetric=True),
    "pressure_tilt_x": Marginal(0.0, 0.3, -1.0, 1.0, symmetric=True),
    "pressure_tilt_y": Marginal(0.0, 0.3, -1.0, 1.0, symmetric=True),
}
NAMES: Final = tuple(UNPUSHED)


@dataclass(frozen=True, slots=True, eq=False)
class SupportPrior:
    """Normal distribution of the support parameters of a part."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)

    @classmethod
    def unpushed(cls) -> SupportPrior:
        """Return the prior before any part has been pushed."""
        rows = UNPUSHED.values()
        return cls(np.array([p.mean for p in rows]), np.diag([p.sd**2 for p in rows]))

    @property
    def factor(self) -> FloatArray:
        """Lower triangle L (n, n) with L L' the covariance."""
        rounding = 1e-12 * np.diag(np.diag(self.covariance))
        return np.asarray(np.linalg.cholesky(self.covariance + rounding), np.float64)

    @property
    def best(self) -> FloatArray:
        """Most probable parameters (n,), within bounds."""
        return np.clip(self.mean, *bounds())

    def at(self, z: FloatArray) -> FloatArray:
        """Return the parameters (k, n) at standard normal coordinates (k, n), within bounds."""
        low, high = bounds()
        return np.clip(self.mean + z @ self.factor.T, low, high)


def bounds() -> tuple[FloatArray, FloatArray]:
    """Return the bounds (n,) of the parameters."""
    rows = UNPUSHED.values()
    return np.array([p.low for p in rows]), np.array([p.high for p in rows])


class PartValues(NamedTuple):
    """Support parameters fitted to the pushes of one part on one surface."""

    part: str
    surface: str
    values: FloatArray  # (n,)
    covariance: FloatArray | float = 0.0  # (n, n) of the values, after the pushes


# Number of imaginary parts, spread as before any push, that mean and covariance are learned with.
IMAGINARY: Final = 1.0
# Factor on the learned covariance: a handful of parts shows less spread than there is, and their
# model misfits. Of 1, 2 and 4, leaving plates out preferred 2 for random pushes and 4 for chosen.
WIDER: Final = 2.0
# Correlations learned from a handful of parts are halved.
CORRELATED: Final = 0.5
# Parameters of a table and its tracker, rather than of a part.
ALWAYS: Final = ("mu_pusher", "registration", "contact_offset")  # whatever the share
ON_SURFACE: Final = (*ALWAYS, "table")


def learned_prior(fits: Sequence[PartValues], surface: str, share: float) -> SupportPrior:
    """Return the prior of a new part on a surface, from other parts on one or several surfaces.

    What belongs to a surface is learned from the parts on it, if there are any. The mean load and
    table of the others have the weight `share`, between 0 (equal loads on a flat table) and 1.
    """
    prior = SupportPrior.unpushed()
    if not fits:
        return prior
    table = np.array([own.values for own in fits])
    on = np.array([own.surface for own in fits])
    overall, known = _centre(fits, prior), dict.fromkeys(on.tolist())
    centres = {name: _centre([own for own in fits if own.surface == name], prior) for name in known}
    of_surface = np.array([name.startswith(ON_SURFACE) for name in NAMES])
    here = np.where(of_surface, centres.get(surface, overall), overall)
    away = table - np.where(of_surface, [centres[name] for name in on.tolist()], overall)
    n_part = len({own.part for own in fits})
    scatter = n_part / max(n_part - 1, 1) / len(fits) * away.T @ away
    scatter = CORRELATED * scatter + (1.0 - CORRELATED) * np.diag(np.diag(scatter))
    covariance = WIDER * (n_part * scatter + IMAGINARY * prior.covariance) / (n_part + IMAGINARY)
    kept = np.array([1.0 if name.startswith(ALWAYS) else share for name in NAMES])
    kept[[UNPUSHED[name].symmetric for name in NAMES]] = 0.0
    return SupportPrior(prior.mean + kept * (here - prior.mean), covariance)


def _centre(fits: Sequence[PartValues], prior: SupportPrior) -> FloatArray:
    """Return the mean parameters (n,) of parts; each counts as far as its pushes determine it."""
    start, one, spread = prior.mean, np.eye(len(prior.mean)), np.diag(prior.covariance)
    known = IMAGINARY * one + sum(one - own.covariance / spread for own in fits)
    return np.asarray(start + np.linalg.solve(known, sum(own.values - start for own in fits)))


WIDTH: Final = 2e-3  # error at which the loss changes from square to linear [m]
LOST: Final = 10e-3  # of a push that cannot be simulated [m]
REACH: Final = 4.0  # of the search, in standard deviations of the prior
ITERATIONS: Final = 8


def fit_part(
    pushes: PartPushes, which: IntArray, prior: SupportPrior, noise: FloatArray
) -> SupportPrior:
    """Fit the parameters of a part to pushes `which` (k,), and return their distribution.

    The errors of each push have the size `noise` (k,) [m]. The distribution has the most probable
    values, and the covariance about them (Laplace's approximation, with the weights of the robust
    loss).
    """
    n = len(prior.mean)
    ones = np.ones(n)
    each = np.repeat(noise, 3)
    width = WIDTH / float(np.mean(noise))
    method = LeastSquares(
        loss="soft_l1",
        width=width,
        differences="one-sided",
        difference=0.15,
        largest_difference=0.6,
        trials=3,
        tolerance=1e-3,
        most_iterations=ITERATIONS,
    )

    def residuals(z: FloatArray) -> FloatArray:
        return _differences(pushes, which, prior.at(z)) / each

    box = SearchBox(-REACH * ones, REACH * ones, 0.0 * ones, ones)
    found = fit(method.start(box, prior=NormalPrior(mean=0.0 * ones, sd=ones)), residuals)
    values = prior.at(found.point[None])[0]
    columns = slopes(pushes, which, SupportPrior(values, prior.covariance)).reshape(-1, n)
    columns /= each[:, None]
    weight = 1.0 / np.sqrt(1.0 + (residuals(found.point[None])[0] / width) ** 2)
    precision = np.eye(n) + columns.T @ (columns * weight[:, None])
    factor = prior.factor
    return SupportPrior(values, factor @ np.linalg.inv(precision) @ factor.T)


def _differences(pushes: PartPushes, which: IntArray, values: FloatArray) -> FloatArray:
    """Return differences (m, 3 k) from the measured ends of pushes (k,) under values (m, n) [m]."""
    ends, good = simulated(pushes, which, values)
    away = ends - pushes.end[which]
    away[..., 2] = ANGLE_SCALE * wrapped(away[..., 2])
    away[~good] = LOST
    return np.asarray(away.reshape(len(values), -1))


def slopes(
    pushes: PartPushes, which: IntArray, prior: SupportPrior, step: float = 0.3
) -> FloatArray:
    """Return derivatives (k, 3, n) of the ends of pushes at the mean of a prior, along its standard
    normal coordinates [m]; angles times their length, zero where a simulation fails."""
    n, k = len(prior.mean), len(which)
    values = prior.at(np.concatenate((step * np.eye(n), -step * np.eye(n))))
    ends, good = simulated(pushes, which, values)
    away = ends[:n] - ends[n:]
    away[..., 2] = ANGLE_SCALE * wrapped(away[..., 2])
    away[~(good[:n] & good[n:])] = 0.0
    table = np.clip(away / (2.0 * step), -LOST, LOST)
    return np.asarray(np.moveaxis(table, 0, 2).reshape(k, 3, n))


def simulated(
    pushes: PartPushes, which: IntArray, values: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the ends (m, k, 3) of pushes `which` (k,) under values (m, n), and which converged."""
    m, k = len(values), len(which)
    given = {name: np.repeat(values[:, j], k) for j, name in enumerate(NAMES)}
    ends, good = pushes.simulate(np.tile(which, m), given)
    return ends.reshape(m, k, 3), good.reshape(m, k)


# How far the part moves and turns, and how much that depends on start, friction and centre of
# pressure. Features of the place or the part do not carry over to other parts.
USED: Final = ("distance", "turned_abs", "sensitiv", "bent", "lost")


def bound_features(
    pushes: PartPushes, which: IntArray, prior: SupportPrior
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return features (k, f) of pushes, their predicted ends (k, 3), and which converged (k,)."""
    ends, good = simulated(pushes, which, prior.best[None])
    best = dict(zip(NAMES, prior.best.tolist(), strict=True))

    def roll(own: IntArray, other: Mapping[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
        values = {name: np.full(len(own), x) for name, x in best.items()} | dict(other)
        found, ended = pushes.simulate(which[own], values)
        return found[:, None], ended

    found = simulated_features(pushes.configurations(which), roll, best["mu_pusher"])
    used = [k for k, name in enumerate(found.names) if name.startswith(USED)]
    # Logarithms, with 0.1 mm or 0.1 mm / 35 mm added: trees do not mind, neighbours do.
    return np.log(np.abs(found.table[:, used]) + 1e-4), ends[0], good[0]


# Size of the error of a push that depends on nothing [m]; and the share of the uncertainty of its
# end that is misfit of the model rather than ignorance of the parameters: where parts flip, and at
# corners, pushes tell less than their sensitivity says.
NOISE: Final = 2.5e-3
MISFIT_SHARE: Final = 0.35


def errors_of(table: FloatArray, noise: float) -> FloatArray:
    """Return the sizes (k,) of the errors of pushes with derivatives (k, 3, n_param) [m]."""
    return np.asarray(np.sqrt(noise**2 + MISFIT_SHARE**2 * np.einsum("kci,kci->k", table, table)))


def choose_pushes(
    candidates: FloatArray, intended: FloatArray, n: int
) -> tuple[IntArray, FloatArray]:
    """Choose n pushes that reduce the mean variance of predicted ends most, one after another.

    Of candidates (m, 3, n_param) there are derivatives of the ends along standard normal
    coordinates of the parameters [m], angles times a length; and the same of `intended`
    (i, 3, n_param), the pushes whose ends matter. Return the chosen ones (k,) in order, and the
    mean variance (k + 1,) of the intended ends before and after each [m^2].
    """
    covariance = np.eye(candidates.shape[2])
    wanted = np.einsum("kci,kcj->ij", intended, intended) / max(len(intended), 1)
    noise = errors_of(candidates, NOISE)[:, None, None] ** 2 * np.eye(candidates.shape[1])
    chosen: list[int] = []
    variance = [float(np.trace(wanted @ covariance))]
    for _ in range(min(n, len(candidates))):
        along = candidates @ covariance
        seen = np.einsum("kci,kdi->kcd", along, candidates) + noise
        gain = np.einsum("kcd,kdi,ij,kcj->k", np.linalg.inv(seen), along, wanted, along)
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        covariance = covariance - along[best].T @ np.linalg.solve(seen[best], along[best])
        variance.append(float(np.trace(wanted @ covariance)))
    return np.array(chosen, np.int64), np.array(variance)


# Quasi-static pushes do not depend on time: all are simulated at one speed, in steps of 1 mm, or
# shorter ones for parts below 3 mm.
PACE: Final = 10e-3  # [m/s]
STEP: Final = 0.1  # [s]
LOST_PUSH: Final = 20e-3  # distance that a push counts that cannot be simulated [m]


class PartPushes:
    """Pushes of one part on one surface, each of one free body by one round pusher."""

    def __init__(self, targets: Sequence[Target], threads: int | None = None) -> None:
        self.targets = tuple(targets)
        for target in targets:
            _check(target)
        scenes = [paced(target.case.scene, float(target.case.times[-1])) for target in targets]
        self.start = np.array([scene.bodies[0].pose for scene in scenes])
        # A push that has not been made ends where it starts.
        self.end = np.array(
            [t.pose[-1] if len(t.pose) else x for t, x in zip(targets, self.start, strict=True)]
        )
        self.body = scenes[0].bodies[0]
        paths = [pusher_path(scene.pushers[0], scene.duration) for scene in scenes]
        self.tip_start = np.array([path[0, 1:3] for path in paths])
        self.tip_end = np.array([path[-1, 1:3] for path in paths])
        self.radius = float(getattr(scenes[0].pushers[0].shape, "radius", 0.0))
        cases = [RolloutCase(scene, np.array([scene.duration])) for scene in scenes]
        self.cases, self.threads = cases, threads
        stepper = StewartTrinkle(step=STEP)
        self._ensemble = Ensemble(cases, QuasiStatic(), stepper, threads=threads)

    def __len__(self) -> int:
        return len(self.targets)

    def simulate(
        self, which: IntArray, values: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, BoolArray]:
        """Simulate pushes `which` (n,) with parameters (n,) by name.

        Return end poses (n, 3) [m, m, rad], the start where a simulation failed, and which
        converged (n,).
        """
        outcome = self._ensemble.simulate(which, values)
        good = outcome.converged
        return np.where(good[:, None], outcome.pose[:, -1], self.start[which]), good

    def in_frame(self, points: FloatArray) -> FloatArray:
        """Return points (n, 2), one per push, in the part's frame at the start of the push [m]."""
        return rotated(points - self.start[:, :2], -self.start[:, 2])

    def errors(self, which: IntArray, ends: FloatArray) -> FloatArray:
        """Return errors (n, 2) of end poses: position [m] and angle [rad]."""
        position, angle = pose_error(ends, self.end[which])
        return np.column_stack((position, np.abs(angle)))

    def configurations(self, which: IntArray) -> Configurations:
        """Return the intended pushes `which` (k,)."""
        return Configurations(
            self.body.shape,
            self.radius,
            self.start[which],
            self.tip_start[which],
            self.tip_end[which],
        )

    def distance(self, which: IntArray, ends: FloatArray, good: BoolArray) -> float:
        """Return the mean distance of end poses (n, 3) from the measured ones [m]; angles times
        their length, failures like a large error."""
        off = self.errors(which, ends)
        return float(np.where(good, off[:, 0] + ANGLE_SCALE * off[:, 1], LOST_PUSH).mean())


def paced(scene: Scene, duration: float) -> Scene:
    """Return a scene whose pusher moves at the common pace, for quasi-static motion."""
    pusher = scene.pushers[0]
    path = pusher_path(pusher, duration)
    path = path[path[:, 0] <= duration]
    way = np.linalg.norm(np.diff(path[:, 1:3], axis=0), axis=1)
    scale = length_scale(scene.bodies[0].shape)
    way += scale * ANGLE_SCALE * np.abs(np.diff(path[:, 3]))
    keep = np.concatenate(([True], way > 0.0))
    path, way = path[keep], way[way > 0.0]
    if len(path) < 2:
        raise InvalidInput("scene.pusher", found="a pusher at rest", expected="a pusher that moves")
    path[:, 0] = np.concatenate(([0.0], np.cumsum(way))) / (scale * PACE)
    drive = PathDrive(path, force_limit=pusher.drive.force_limit)
    moving = replace(pusher, pose=path[0, 1:], drive=drive, restitution=0.0)
    return replace(scene, pushers=(moving,), duration=float(path[-1, 0]))


def _check(target: Target) -> None:
    scene = target.case.scene
    check_push(scene, f"experiment {target.key}.scene")
    if not isinstance(scene.pushers[0].shape, Disk):
        raise InvalidInput(
            f"experiment {target.key}.scene", found="a pusher that is not round", expected="a disk"
        )
