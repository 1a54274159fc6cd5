"""Derivatives of the end of a quasi-static simulation by its start pose and by parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels.arrays import StepMethod
from fixel.kernels.modes.derivatives import differentiate_batch
from fixel.model import Scene
from fixel.model.parameters import info_of
from fixel.simulation.accuracy import walked
from fixel.simulation.pack import PackedBatch
from fixel.simulation.threads import in_ranges
from fixel.simulation.vary import Variation
from fixel.typing import BoolArray, FloatArray

NUDGE: Final = 1e-4  # of a parameter, to differentiate the rows of contacts
SMALLEST_NUDGE: Final = 1e-7  # of a parameter that is zero, in SI units


def nudged(scene: Scene, variation: Variation, names: Sequence[str], n: int) -> Variation:
    """Return a variation in which every rollout is followed by two for each parameter: a little
    larger, and a little smaller."""
    stride = 1 + 2 * len(names)
    values = {k: np.repeat(v, stride) for k, v in variation.parameters.items()}
    for j, name in enumerate(names):
        if name not in values:
            values[name] = np.full(n * stride, scene_value(scene, name))
        width = nudge_of(values[name][::stride])
        values[name][1 + 2 * j :: stride] += width
        values[name][2 + 2 * j :: stride] -= width
    if variation.path_of is not None or variation.fixels is not None:
        raise InvalidInput(
            "derivatives", found="paths or fixels of many rollouts", expected="one path"
        )
    return Variation(
        values,
        None if variation.start is None else np.repeat(variation.start, stride, axis=0),
        None if variation.path is None else np.repeat(variation.path, stride, axis=0),
    )


def nudge_of(value: FloatArray) -> FloatArray:
    """Small change of a parameter, in SI units."""
    return np.maximum(NUDGE * np.abs(value), SMALLEST_NUDGE)


def scene_value(scene: Scene, name: str) -> float:
    """Value of a parameter in a scene; raise for one that the scene does not state."""
    info = info_of(name)
    body = scene.bodies[0]
    value: float | None = None
    if info.contact:
        things = scene.pushers if info.contact == "pusher" else scene.fixels
        found = {scene.friction(body.name, thing.name) for thing in things}
        value = found.pop() if len(found) == 1 else None
    elif info.lowest < 0.0 or name == "contact_offset":
        value = 0.0
    elif name == "mass":
        value = body.mass
    elif name in ("mu_support", "tripod_radius"):
        value = getattr(body.support, "friction" if name == "mu_support" else "radius", None)
    if not isinstance(value, float | int):
        raise InvalidInput(
            "derivatives",
            found=f"{name}, for which the scene has no single value",
            expected="a parameter with one value",
            hint=f"give its value in parameters={{'{name}': ...}}",
        )
    return float(value)


def end_derivatives(
    packed: PackedBatch,
    method: StepMethod,
    values: Mapping[str, FloatArray],
    names: Sequence[str],
    heading: FloatArray,
    threads: int | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Differentiate the last pose of the part.

    Parameters
    ----------
    packed : PackedBatch
        Of a variation by `nudged`.
    method : StepMethod
    values : mapping from name to (n * stride,) float64
        Those of that variation.
    names : sequence of str
        Names of the parameters.
    heading : (n,) float64
        Angle of the part at the start [rad].
    threads : int, optional

    Returns
    -------
    (n, 3, 3 + n_parameter) float64
        Derivatives of x, y, theta by x, y and theta at the start and by the parameters, in SI
        units.
    (n,) bool
        Whether there are derivatives: every mode held, and ended where a margin crosses zero.
    """
    stride = 1 + 2 * len(names)
    n = len(heading)
    record = walked(packed, method, n, stride=stride, taped=True, threads=threads)
    slope = np.zeros((n, 3, 3 + len(names)))
    found = np.zeros(n, np.int64)
    in_ranges(
        partial(differentiate_batch, packed.batch, method, stride, record, slope, found), n, threads
    )
    length = packed.units.length
    slope[:, :2, 2:] *= length
    slope[:, 2, :2] /= length
    for j, name in enumerate(names):
        slope[:, :, 3 + j] /= nudge_of(values[name][::stride])[:, None]
    # From poses of the centre of mass to those of the shape frame, at both ends.
    x, y = packed.com[0]
    slope[:, :, 2] += np.einsum("nij,nj->ni", slope[:, :, :2], _lever(x, y, heading))
    slope[:, :2] -= _lever(x, y, record.end[:, 2])[:, :, None] * slope[:, 2][:, None]
    return slope, found == 1


def _lever(x: float, y: float, angle: FloatArray) -> FloatArray:
    """Derivative of a rotated vector by the angle (n, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((-s * x - c * y, c * x - s * y), axis=-1)
