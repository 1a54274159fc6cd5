"""Friction and support of the worlds that episodes take place in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final, final

import numpy as np

from fixel.calibration.known_pushes import KnownPushes
from fixel.errors import InvalidInput
from fixel.model import Body, Ellipsoid, Scene, Support, SupportPoints, Tripod, UniformPressure
from fixel.model.footprint import cells
from fixel.planning.belief import Belief
from fixel.simulation.vary import infeasible
from fixel.typing import IntArray

DRAWS: Final = 1024  # of the parameters, from which episodes choose
FORCE: Final = 1.0  # [N] of an ellipsoid; quasi-static motion does not depend on it
FRICTION: Final = 0.25  # against the plane, which quasi-static motion does not depend on either
MAX_REDRAWS: Final = 1000  # of a start with overlap
# Ratio of the arms of calibrated plates to that of uniform pressure.
ARM_RANGE: Final = (0.55, 1.9)
# Errors of the experiments of a calibration, which are no properties of the world.
_OF_EXPERIMENTS: Final = ("registration_", "outline_", "start_")
# Parameters in metres, which no part shares with one of another outline.
_OF_ONE_PART: Final = ("tripod_", "support_", "ellipsoid_")


@final
class WorldDraws:
    """Parameters of a scene in n environments, drawn again for each episode.

    Parameters
    ----------
    scene : Scene
    parameters : Belief, or what `Belief` takes as its parameters
        Distribution of the parameters.
    n : int
        Number of environments.

    Attributes
    ----------
    scene : Scene
        The scene, with a support that the parameters can describe.
    values : mapping of str to (n,) float64
        Parameters of the episodes [SI].

    Raises
    ------
    InvalidInput
        No draw can be simulated with the scene, a name does not suit it, or the support was
        calibrated on a part with another outline.
    """

    def __init__(self, scene: Scene, parameters: Any, n: int) -> None:
        belief = parameters if isinstance(parameters, Belief) else Belief(parameters=parameters)
        found = belief.scenarios(scene, worlds=DRAWS, runs=1).values
        draws = {
            name: np.asarray(x, np.float64)
            for name, x in found.items()
            if not name.startswith(_OF_EXPERIMENTS)
        }
        _refuse_other_part(scene, belief, draws)
        self.scene = _with_support(scene, draws)
        reasons = infeasible(self.scene, draws) if draws else []
        ready = np.flatnonzero([not reason for reason in reasons])
        if not len(ready):
            raise InvalidInput(
                "parameters",
                found=f"no draw that can be simulated: {reasons[0]}" if reasons else "none",
                expected="parameters that suit the scene",
            )
        self._draws = {name: x[ready] for name, x in draws.items()}
        self._count = len(ready)
        self.values = {name: np.full(n, x[0]) for name, x in self._draws.items()}

    def redraw(self, which: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the parameters of the episodes that begin in environments `which` (k,)."""
        for k in which.tolist():
            row = int(rngs[k].integers(self._count))
            for name, x in self._draws.items():
                self.values[name][k] = x[row]


def usual_parameters(friction: tuple[float, float], arm: float) -> dict[str, tuple[float, float]]:
    """Return the ranges of friction and support, about an arm of uniform pressure [m]."""
    low, high = ARM_RANGE
    return {"mu_pusher": friction, "ellipsoid_torque": (low * FORCE * arm, high * FORCE * arm)}


def _refuse_other_part(scene: Scene, belief: Belief, names: Iterable[str]) -> None:
    """Raise for the support of a calibrated part whose outline is not that of the scene's body."""
    known = getattr(belief.parameters, "known", None)
    own = [name for name in names if name.startswith(_OF_ONE_PART)]
    if own and isinstance(known, KnownPushes) and not known.has_outline(scene):
        raise InvalidInput(
            f"parameters.{own[0]}",
            found="values of a part with another outline than the one that is pushed here",
            expected="a calibration of this part",
            hint="or ranges by name, such as parameters={'mu_pusher': (0.1, 0.3)}",
        )


def _with_support(scene: Scene, names: Iterable[str]) -> Scene:
    """Return the scene with the support that parameters of these names describe."""
    body, arm = scene.bodies[0], pressure_arm(scene.bodies[0])
    support: Support | None = None
    for name in names:
        if name == "tripod_radius":
            support = Tripod(radius=arm, friction=FRICTION)
        elif name.startswith("support_"):
            turns = 2.0 * np.pi * np.arange(3) / 3.0
            points = body.com + arm * np.column_stack((np.cos(turns), np.sin(turns)))
            support = SupportPoints(points=points, friction=FRICTION)
        elif name.startswith("pressure_"):
            support = UniformPressure(friction=FRICTION)
        elif name.startswith("ellipsoid_"):
            support = Ellipsoid(force=FORCE, torque=FORCE * arm, centre=body.com)
    return scene if support is None else replace(scene, bodies=(replace(body, support=support),))


def pressure_arm(body: Body) -> float:
    """Compute the mean distance of the outline's area from the centre of mass [m].

    It is the ratio of largest friction torque to largest friction force under uniform pressure.
    """
    points, share = cells(body.shape, 4000)
    return float(share @ np.hypot(*(points - body.com).T) / share.sum())
