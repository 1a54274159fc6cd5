"""Scatter between runs of the same push: start, friction, pressure centre, and a remainder.

A calibrated simulator predicts the same end for the same push. Real pushes end elsewhere each time,
and farther apart the more the part moves and turns. Most of that is explained by a friction of the
contact and a centre of pressure that differ between runs: they change nothing while the
part is at rest. They act inside the simulation, where walls and pegs can take their effect back.
What remains grows with the rotation, and is added to ends where the part touches nothing.

All lengths are in radii of gyration of the part, so that a scatter applies to parts of any size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, NamedTuple, final

import numpy as np

from fixel.calibration.target import Target, target_of
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters, Scene, wrapped
from fixel.model.fields import Value, check_fields, instance, non_negative
from fixel.model.trajectory import pose_difference
from fixel.simulation.motion import AbstractMotionModel, QuasiStatic
from fixel.simulation.rollouts import ensemble_of
from fixel.simulation.stepping import AbstractStepper
from fixel.typing import FloatArray, IntArray
from fixel.uncertainty.predictive import CalibratedModel

# Scatter of real pushes: rounded medians of the 14 plates and surfaces of the MIT push dataset.
START, CENTRE, FRICTION = 0.001, 0.12, 0.25
NOISE_POSITION, NOISE_ANGLE = 0.005, 0.005
REST_POSITION, REST_ANGLE = 0.02, 0.04
FREEDOM: Final = 3.0
# Bounds of the degrees of freedom of Student's t: from "a mean exists" to "normal".
FREEDOMS: Final = (1.5, 50.0)
# Largest factor of Student's t on the scatter of one run: 5 % of the runs would exceed it.
MAX_FACTOR: Final = 3.0
# Standard deviation of the logarithm of a scatter over its default, before any experiment.
PRIOR: Final = 1.0
MIN_EXPERIMENTS: Final = 3
# Draws of each experiment from which the remainder is learned.
DRAWS: Final = 64
# Size at which the effects on ends are taken, in default scatters: tails decide about 90 % regions,
# and large changes have smaller effects than in proportion.
FAR: Final = 2.0
# Rotation at which the remainder of a draw is given [rad].
TURN: Final = 0.25
_NUMBERS: Final = (
    "start", "centre", "friction",
    "noise_position", "noise_angle", "rest_position", "rest_angle",
)  # fmt: skip
_SHIFTS: Final = ("start_x", "start_y", "start_theta")
_CENTRES: Final = ("friction_centre_x", "friction_centre_y")
NotNegative = Annotated[float, Value(non_negative)]


class RunChanges(NamedTuple):
    """Parameters and errors of n runs."""

    values: dict[str, FloatArray]  # parameters (n,) by name, with the scatter of each run
    start: FloatArray  # (n, 3) errors of the start [m, m, rad]
    rest: FloatArray  # (n, 3) errors of the end, for a part that turns by `TURN` [m, m, rad]

    @property
    def parameters(self) -> dict[str, FloatArray]:
        """Parameters of the runs, with the errors of the start added to those that are given."""
        own = zip(_SHIFTS, self.start.T, strict=True)
        return self.values | {name: self.values.get(name, 0.0) + error for name, error in own}


class RunEffects(NamedTuple):
    """Errors of k predicted ends, and what the default scatter would change there.

    Positions are in radii of gyration of the part, angles in radians.
    """

    residual: FloatArray  # (k, 3) measured minus predicted
    start: FloatArray  # (k, 3, 3) change with each coordinate of the start
    centre: FloatArray  # (k, 3, 2) change with each coordinate of the pressure centre
    friction: FloatArray  # (k, 3, 1) change with the friction of the pusher
    turned: FloatArray  # (k,) predicted rotation [rad]
    known: FloatArray | float = 0.0  # (k, 3, 3) covariance from other sources, as of parameters


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RunToRun:
    """Scatter between runs of the same push.

    The default is the scatter of real pushes of the MIT push dataset; `learned` fits it to
    experiments. Numbers are scales of Student's t.

    Parameters
    ----------
    start : float
        Error of the start: along either axis in radii of gyration, of the angle in radians.
    centre : float
        Shift of the pressure centre along either axis of the part, in radii of gyration.
    friction : float
        Relative scatter of the friction of the pusher and the fixels.
    rest_position, rest_angle : float
        Remaining error of the end per radian that the part turns: position in radii of gyration,
        angle in radians.
    noise_position, noise_angle : float
        Error of a measured end: position in radii of gyration, angle in radians. It is no part of a
        run.
    freedom : float
        Degrees of freedom of Student's t, at least 1.5.
    experiments : int
        Number of experiments that it was learned from; 0 for the default.

    Examples
    --------
    >>> from fixel.testing.scenes import pushed_square
    >>> runs = RunToRun().drawn(100, seed=1, scene=pushed_square(), values={})
    >>> sorted(runs.values)
    ['friction_centre_x', 'friction_centre_y', 'mu_pusher']
    """

    start: NotNegative = START
    centre: NotNegative = CENTRE
    friction: NotNegative = FRICTION
    rest_position: NotNegative = REST_POSITION
    rest_angle: NotNegative = REST_ANGLE
    noise_position: NotNegative = NOISE_POSITION
    noise_angle: NotNegative = NOISE_ANGLE
    freedom: float = FREEDOM
    experiments: int = 0

    def __post_init__(self) -> None:
        check_fields(self, "run_to_run")
        if not self.freedom >= FREEDOMS[0]:
            raise InvalidInput(
                "run_to_run.freedom", found=self.freedom, expected=f"{FREEDOMS[0]} or more"
            )

    @classmethod
    def of_friction(cls, scatter: float) -> RunToRun:
        """Return a scatter of friction alone, near a normal distribution of its logarithm."""
        none: dict[str, Any] = dict.fromkeys(_NUMBERS, 0.0) | {"friction": scatter}
        return cls(**none, freedom=FREEDOMS[1])

    @classmethod
    def learned(cls, effects: RunEffects, *, fitted: int = 0) -> RunToRun:
        """Fit the scatter to the errors of experiments, by their linear effects.

        The prior is the default within a factor of three, so few experiments change little.

        Parameters
        ----------
        effects : RunEffects
            Errors of experiments and effects on them.
        fitted : int
            Number of parameters that were fitted to the same experiments, whose errors are smaller.

        Raises
        ------
        InvalidInput
            There are fewer than three experiments, or as many parameters as measured numbers.
        """
        from scipy.optimize import minimize

        k = len(effects.residual)
        if k < MIN_EXPERIMENTS:
            found = f"{k} that could be simulated"
            expected = f"at least {MIN_EXPERIMENTS}"
            hint = "RunToRun() is the scatter of public real pushes"
            raise InvalidInput("experiments", found=found, expected=expected, hint=hint)
        left = 1.0 - fitted / (3.0 * k)
        if not left > 0.0:
            raise InvalidInput(
                "fitted",
                found=f"{fitted} parameters for {k} experiments",
                expected=f"fewer than {3 * k}",
            )
        residual = effects.residual / math.sqrt(left)
        parts = _unit_covariances(effects)
        usual = np.append(np.zeros(len(parts)), math.log(FREEDOM))

        def cost(z: FloatArray) -> float:
            total = _total(z[:-1], parts, effects.known)
            own = float(np.exp(np.clip(z[-1], *np.log(FREEDOMS))))
            return (
                -log_student(residual, total, own)
                + 0.5 * float(np.sum((z - usual) ** 2)) / PRIOR**2
            )

        z = minimize(cost, usual, method="L-BFGS-B").x
        default = cls()
        factors = np.exp(z[:-1]).tolist()
        numbers = {
            name: getattr(default, name) * factor
            for name, factor in zip(_NUMBERS, factors, strict=True)
        }
        freedom = float(np.exp(np.clip(z[-1], *np.log(FREEDOMS))))
        return cls(**numbers, freedom=freedom, experiments=k)

    def with_remainder(
        self, residual: FloatArray, drawn: FloatArray, turned: FloatArray
    ) -> RunToRun:
        """Fit remainder and noise to errors, given the simulated effects of the other numbers.

        Unlike `learned`, this is right for effects that do not grow in proportion.

        Parameters
        ----------
        residual : (k, 3) float64
            Measured minus predicted ends: positions in radii of gyration, angles [rad].
        drawn : (k, n, 3) float64
            Simulated ends of n runs of each, in the same way; NaN where one failed.
        turned : (k,) float64
            Predicted rotation [rad].
        """
        from scipy.optimize import minimize
        from scipy.stats import t as student

        low, high = np.nanquantile(drawn, (0.16, 0.84), axis=1, method="weibull")
        inside = (0.5 * (high - low) / student.ppf(0.84, self.freedom)) ** 2
        names = ("noise_position", "noise_angle", "rest_position", "rest_angle")
        usual = np.log([max(getattr(self, name), 1e-6) for name in names])

        def cost(z: FloatArray) -> float:
            square = np.exp(2.0 * z)
            own = square[:2] + square[2:] * turned[:, None] ** 2
            scale = np.sqrt(inside + own[:, [0, 0, 1]])
            fit = student.logpdf(residual / scale, self.freedom) - np.log(scale)
            return 0.5 * float(np.sum((z - usual) ** 2)) / PRIOR**2 - float(fit.sum())

        z = minimize(cost, usual, method="L-BFGS-B").x
        return replace(self, **dict(zip(names, np.exp(z).tolist(), strict=True)))

    def drawn(
        self, n: int, *, seed: int, scene: Scene, values: Mapping[str, FloatArray] | None = None
    ) -> RunChanges:
        """Draw the changes of n runs.

        Parameters
        ----------
        n : int
        seed : int
        scene : Scene
            Scene with one free body.
        values : mapping of str to (n,) float64, optional
            Parameters of the runs, about which those of a run scatter; by default the scene's.
        """
        rng = np.random.default_rng(seed)
        factor = np.sqrt(self.freedom / rng.chisquare(self.freedom, n))
        factor = np.minimum(factor, MAX_FACTOR)
        normal = factor[:, None] * rng.standard_normal((n, 10))
        arm = arm_of(scene)
        found = dict(values or {})
        for name, column in zip(_CENTRES, normal[:, :2].T, strict=True):
            found[name] = found.get(name, 0.0) + arm * self.centre * column
        usual: dict[str, Any] = {**contact_friction(scene), **found}
        for name, column in zip(("mu_pusher", "mu_fixel"), normal[:, 2:4].T, strict=True):
            if name in usual:
                found[name] = usual[name] * np.exp(self.friction * column)
        size = np.array([arm, arm, 1.0])
        rest = TURN * np.array([self.rest_position, self.rest_position, self.rest_angle])
        return RunChanges(found, self.start * size * normal[:, 4:7], rest * size * normal[:, 7:])

    def noise(self, scene: Scene) -> FloatArray:
        """Return the standard deviations (3,) of measured ends [m, m, rad]."""
        arm = arm_of(scene)
        position = arm * self.noise_position
        return np.array([position, position, self.noise_angle])


def rest_at(rest: FloatArray, turned: FloatArray) -> FloatArray:
    """Return errors (..., 3) of ends after rotations (...) [rad], from `RunChanges.rest`."""
    return np.asarray(rest * (np.abs(turned) / TURN)[..., None])


def arm_of(scene: Scene) -> float:
    """Return the radius of gyration of the free body [m]."""
    return math.sqrt(scene.bodies[0].shape.unit_inertia)


def contact_friction(scene: Scene) -> dict[str, float]:
    """Return the friction of pusher and fixels, `mu_pusher` and `mu_fixel`.

    A kind is left out if there is none of it, or if its members differ.
    """
    body, found = scene.bodies[0].name, {}
    for name, others in (("mu_pusher", scene.pushers), ("mu_fixel", scene.fixels)):
        own = {scene.friction(body, other.name) for other in others}
        if len(own) == 1:
            found[name] = own.pop()
    return found


# --- errors of experiments ------------------------------------------------------------------------


def learn_run_to_run(
    experiments: Sequence[Experiment],
    model: Mapping[str, float] | CalibratedModel,
    *,
    fitted: int = 0,
    motion: AbstractMotionModel | None = None,
    stepper: AbstractStepper | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> RunToRun:
    """Learn the scatter between runs from the errors of predicted experiments.

    Experiments that cannot be simulated are left out.

    Parameters
    ----------
    experiments : sequence of Experiment
        Experiments, preferably not used for the calibration.
    model : mapping of str to float or Calibration
        Parameters [SI].
    fitted : int
        Number of parameters that were fitted to the same experiments.
    motion : AbstractMotionModel, optional
        By default that of the calibration, else quasi-static.
    stepper : AbstractStepper, optional
    seed : int
    threads : int, optional

    Examples
    --------
    >>> from fixel.testing.pushes import example_pushes
    >>> learn_run_to_run(example_pushes(6, duration=0.5), {"mu_pusher": 0.2}).experiments
    6
    """
    instance(experiments, Sequence, "experiments", "experiments")
    for experiment in experiments:
        instance(experiment, Experiment, "experiments", "experiments")
    if not len(experiments):
        raise InvalidInput("experiments", found="none", expected="at least one")
    motion = motion or getattr(model, "motion", None)
    ends = _ExperimentEnds([target_of(e) for e in experiments], model, motion, stepper, threads)
    effects = ends.effects()
    scatter = RunToRun.learned(effects, fitted=fitted)
    left = effects.residual / math.sqrt(1.0 - fitted / (3.0 * len(effects.residual)))
    return scatter.with_remainder(left, ends.drawn(scatter, seed), effects.turned)


class _ExperimentEnds:
    """Simulated ends of experiments: positions in radii of gyration, angles in radians."""

    def __init__(
        self,
        targets: Sequence[Target],
        model: Mapping[str, float] | CalibratedModel,
        motion: AbstractMotionModel | None,
        stepper: AbstractStepper | None,
        threads: int | None,
    ) -> None:
        given = [
            model.values_for(**target.conditions)
            if isinstance(model, CalibratedModel)
            else dict(Parameters(model))
            for target in targets
        ]
        names = sorted({name for own in given for name in own})
        if any(sorted(own) != names for own in given):
            raise InvalidInput(
                "model", found="different parameters for experiments", expected="the same for all"
            )
        cases = [t.case._replace(times=t.case.times[-1:]) for t in targets]
        table = {name: np.array([own[name] for own in given]) for name in names}
        self._ensemble = ensemble_of(cases, motion or QuasiStatic(), stepper, threads)
        base = self._poses(np.arange(len(cases)), table)
        self._rows = np.flatnonzero(np.isfinite(base).all(axis=1))
        self._scenes = [cases[k].scene for k in self._rows]
        self._table = {name: column[self._rows] for name, column in table.items()}
        self._base = base[self._rows]
        self._measured = np.array([targets[k].pose[-1] for k in self._rows.tolist()]).reshape(-1, 3)
        arm = np.array([arm_of(scene) for scene in self._scenes])
        self._size = np.column_stack((arm, arm, np.ones(len(arm))))

    def effects(self) -> RunEffects:
        """Return the errors of the predicted ends, and the effects of the default scatter."""
        start = np.array([scene.bodies[0].pose for scene in self._scenes]).reshape(-1, 3)
        own = [contact_friction(scene).get("mu_pusher", 0.0) for scene in self._scenes]
        mu = self._table.get("mu_pusher", np.array(own))
        friction = [mu * np.exp(way * FAR * FRICTION) for way in (-1.0, 1.0)]
        return RunEffects(
            residual=pose_difference(self._measured, self._base) / self._size,
            start=np.stack(
                [
                    self._effect(name, *self._around(name, START * length))
                    for name, length in zip(_SHIFTS, self._size.T, strict=True)
                ],
                axis=2,
            ),
            centre=np.stack(
                [self._effect(c, *self._around(c, CENTRE * self._size[:, 0])) for c in _CENTRES],
                axis=2,
            ),
            friction=self._effect("mu_pusher", *friction)[:, :, None],
            turned=np.abs(wrapped(self._base[:, 2] - start[:, 2])),
        )

    def drawn(self, scatter: RunToRun, seed: int) -> FloatArray:
        """Return the changes (k, n, 3) of ends in n draws of the scatter; NaN where one failed."""
        found = []
        for k, scene in enumerate(self._scenes):
            own = {name: np.full(DRAWS, column[k]) for name, column in self._table.items()}
            changes = scatter.drawn(DRAWS, seed=seed + k, scene=scene, values=own)
            ends = self._poses(np.full(DRAWS, self._rows[k]), changes.parameters)
            found.append(pose_difference(ends, self._base[k]) / self._size[k])
        return np.array(found)

    def _around(self, name: str, size: FloatArray) -> list[FloatArray]:
        return [self._table.get(name, 0.0) + way * FAR * size for way in (-1.0, 1.0)]

    def _effect(self, name: str, low: FloatArray, high: FloatArray) -> FloatArray:
        ends = [self._poses(self._rows, self._table | {name: own}) for own in (low, high)]
        return np.asarray(np.nan_to_num(0.5 / FAR * pose_difference(*ends[::-1]) / self._size))

    def _poses(self, which: IntArray, values: Mapping[str, FloatArray]) -> FloatArray:
        outcome = self._ensemble.simulate(which, values)
        return np.asarray(np.where(outcome.converged[:, None], outcome.pose[:, -1], np.nan))


# --- likelihood -----------------------------------------------------------------------------------


def _unit_covariances(effects: RunEffects) -> FloatArray:
    """Return the covariances (7, k, 3, 3) of the default scatter, in the order of `_NUMBERS`."""
    position, angle = np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0])
    turned = (effects.turned**2)[:, None, None]
    even = np.ones_like(turned)
    return np.array(
        [
            *(
                np.matmul(column, column.transpose(0, 2, 1))
                for column in (effects.start, effects.centre, effects.friction)
            ),
            NOISE_POSITION**2 * even * position,
            NOISE_ANGLE**2 * even * angle,
            REST_POSITION**2 * turned * position,
            REST_ANGLE**2 * turned * angle,
        ]
    )


def _total(z: FloatArray, parts: FloatArray, known: FloatArray | float) -> FloatArray:
    """Return covariances (k, 3, 3) for logarithms of factors on the parts."""
    factor = np.exp(2.0 * np.clip(z, -7.0, 4.0))
    return np.asarray(np.einsum("p,pkij->kij", factor, parts) + known + 1e-12 * np.eye(3))


def log_student(residual: FloatArray, scale: FloatArray, freedom: float) -> float:
    """Return the log likelihood of residuals (k, c) under Student's t with scales (k, c, c)."""
    from scipy.special import gammaln

    k, c = residual.shape
    square = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(scale), residual)
    _, volume = np.linalg.slogdet(scale)
    constant = gammaln(0.5 * (freedom + c)) - gammaln(0.5 * freedom)
    constant -= 0.5 * c * np.log(freedom * np.pi)
    tails = 0.5 * (freedom + c) * np.log1p(square / freedom)
    return float(k * constant - 0.5 * volume.sum() - tails.sum())
