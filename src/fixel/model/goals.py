"""Goals of a push or grasp: conditions on the poses at its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from fixel.errors import InvalidInput
from fixel.model.bodies import Body
from fixel.model.fields import settle
from fixel.model.overlap import overlaps
from fixel.model.scene import Scene
from fixel.typing import BoolArray, FloatArray

# Gap up to which a body counts as touching a fixel, as a share of the body's size. A simulated
# contact is closed to about 1e-6 of it.
TOUCHING: Final = 1e-3


@final
@dataclass(frozen=True, slots=True, init=False)
class Seated:
    """Goal that a body touches all of the named fixels at the end.

    Parameters
    ----------
    *fixels : str
        Names of the fixels, one at least. Contacts with others do not matter.
    body : str, optional
        Name of the body; by default the only free body of the scene.

    Examples
    --------
    >>> from fixel import simulate
    >>> from fixel.testing.scenes import grasp
    >>> simulate(grasp("seated")).meets(Seated("fixel-1"))
    True
    """

    fixels: tuple[str, ...]
    body: str | None

    def __init__(self, *fixels: str, body: str | None = None) -> None:
        if not fixels or not all(fixels):
            raise InvalidInput("fixels", found=repr(fixels), expected="names of fixels")
        settle(self, fixels=tuple(fixels), body=body)

    def __repr__(self) -> str:
        names = [repr(name) for name in self.fixels]
        return (
            f"Seated({', '.join(names + ([] if self.body is None else [f'body={self.body!r}']))})"
        )

    def met(self, scene: Scene, ends: Mapping[str, FloatArray]) -> BoolArray:
        """Return whether the goal is met at end poses.

        Parameters
        ----------
        scene : Scene
        ends : mapping of str to (..., 3) float64
            End poses of the free bodies, by name [m, m, rad].

        Returns
        -------
        (...) bool

        Raises
        ------
        InvalidInput
            The scene has no such fixel or body.
        """
        body = self._body(scene)
        pose = np.asarray(ends[body.name], np.float64)
        touched = touching(scene, body, pose.reshape(-1, 3))
        names = [fixel.name for fixel in scene.fixels]
        for name in self.fixels:
            if name not in names:
                expected = "one of " + ", ".join(names) if names else "a scene with fixels"
                raise InvalidInput("goal.fixels", found=repr(name), expected=expected)
        own = touched[:, [names.index(name) for name in self.fixels]]
        return np.asarray(own.all(axis=1).reshape(pose.shape[:-1]))

    def _body(self, scene: Scene) -> Body:
        if self.body is None and len(scene.bodies) == 1:
            return scene.bodies[0]
        for body in scene.bodies:
            if body.name == self.body:
                return body
        names = ", ".join(body.name for body in scene.bodies)
        raise InvalidInput("goal.body", found=repr(self.body), expected=f"one of {names}")


def touching(scene: Scene, body: Body, poses: FloatArray) -> BoolArray:
    """Return the contacts (n, n_fixel) of a body with the fixels of its scene at poses (n, 3)."""
    gap = TOUCHING * float(np.ptp(body.shape.outline, axis=0).max())
    found = [overlaps(body.shape, poses, f.shape, f.pose).depth > -gap for f in scene.fixels]
    return np.array(found, bool).reshape(len(found), len(poses)).T
