"""Derivatives of quasi-static motion by its start pose and by parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from fixel.errors import InvalidInput
from fixel.kernels import codes
from fixel.kernels.arrays import BODY, DURATION, StepMethod
from fixel.kernels.modes import walk
from fixel.kernels.modes.derivatives import differentiate_batch
from fixel.model import Scene, rotated
from fixel.model.parameters import info_of
from fixel.simulation.accuracy import APART_ANGLE, APART_LENGTH, empty_modes
from fixel.simulation.load_profile import PROFILE_NAMES, TABLE_NAMES
from fixel.simulation.motion import AbstractMotionModel
from fixel.simulation.pack import PackedBatch
from fixel.simulation.result import POSE_NAMES
from fixel.simulation.threads import in_ranges, shape_poses
from fixel.simulation.vary import Variation, composed
from fixel.typing import BoolArray, FloatArray, IntArray

NUDGE: Final = 1e-6  # of a parameter, to differentiate the rows of contacts
SMALLEST_NUDGE: Final = 1e-7  # of a parameter that is zero, in SI units
PASS: Final = 512  # rollouts whose tapes are held at once


def check_differentiable(scene: Scene, motion: AbstractMotionModel) -> None:
    """Raise where contact modes do not describe the motion."""
    if motion.kind != codes.QUASI_STATIC or len(scene.bodies) != 1:
        found = f"{motion.name} motion of {len(scene.bodies)} free bodies"
        expected = "quasi-static motion of one body"
        hint = 'motion="quasistatic"'
        raise InvalidInput("derivatives", found=found, expected=expected, hint=hint)


def end_slopes(
    scene: Scene,
    variation: Variation,
    names: Sequence[str],
    packed_of: Callable[[Variation, int], PackedBatch],
    method: StepMethod,
    pose: FloatArray,
    ended: BoolArray,
    threads: int | None = None,
) -> tuple[dict[str, FloatArray], BoolArray, walk.ModeRecord]:
    """Differentiate the last pose of one part by its start pose and by parameters.

    `names` are parameters, or ``"x"``, ``"y"`` and ``"theta"`` of the start pose. `packed_of` packs
    a number of rollouts of another variation. Rollouts have the last poses `pose` (n, 3); `ended`
    (n,) are those that were not stopped before. Returns derivatives (n, 3) of x, y and theta by
    name in SI units, NaN where there are none, a mask (n,) of the rollouts that have any, and the
    modes that all passed through.
    """
    columns = _columns(scene, names, variation)
    own = [name for name in dict.fromkeys(columns) if name not in POSE_NAMES]
    order = [*POSE_NAMES, *own]
    place = [order.index(name) for name in columns]
    slope = np.full((len(columns), len(pose), 3), np.nan)
    record = empty_modes(len(pose))
    for k in range(0, len(pose), PASS):
        rows = np.arange(k, min(len(pose), k + PASS))
        again = np.repeat(rows, 1 + len(own))
        nudges, widths = _nudged(scene, variation, own, again)
        packed = packed_of(nudges, len(again))
        modes = walk.ModeRecord._make(array[k : k + PASS] for array in record)
        part, good = _slopes(packed, method, widths, pose[rows], modes, threads)
        good &= ended[rows]
        slope[:, rows[good]] = part[good].transpose(2, 0, 1)[place]
    return dict(zip(names, slope, strict=True)), ~np.isnan(slope[..., 0]).any(axis=0), record


def _columns(scene: Scene, names: Sequence[str], variation: Variation) -> list[str]:
    """Return the names to differentiate by; loads on an uneven table depend on the start pose."""
    if scene.plane.load_map is not None:
        return [f"start_{name}" if name in POSE_NAMES else name for name in names]
    uneven = any(name in (*TABLE_NAMES, *PROFILE_NAMES) for name in (*variation.parameters, *names))
    return ["start_theta" if uneven and name == "theta" else name for name in names]


def _nudged(
    scene: Scene, variation: Variation, names: Sequence[str], rows: IntArray
) -> tuple[Variation, FloatArray]:
    """Return a variation in which every rollout is followed by one for each parameter, a little
    larger, and by how much (n, n_parameter)."""
    stride = 1 + len(names)
    values = {k: np.array(v[rows]) for k, v in variation.parameters.items()}
    widths = np.zeros((len(rows) // stride, len(names)))
    for j, name in enumerate(names):
        if name not in values:
            values[name] = np.full(len(rows), scene_value(scene, name))
        widths[:, j] = np.maximum(NUDGE * np.abs(values[name][::stride]), SMALLEST_NUDGE)
        values[name][1 + j :: stride] += widths[:, j]
    start, path, of, fixels = variation[1:]
    nudges = Variation(
        values,
        None if start is None else start[rows],
        path if path is None or of is not None else path[rows],
        None if of is None else of[rows],
        None if fixels is None else fixels[rows],
    )
    return nudges, widths


def scene_value(scene: Scene, name: str) -> float:
    """Value of a parameter in a scene; raise for one that the scene does not state."""
    info = info_of(name)
    body = scene.bodies[0]
    value: float | None = None
    if info.contact:
        things = scene.pushers if info.contact == "pusher" else scene.fixels
        found = {scene.friction(body.name, thing.name) for thing in things}
        value = found.pop() if len(found) == 1 else None
    elif name.startswith("support_"):
        points: Any = getattr(body.support, "points", ())
        value = points[int(name[8]) - 1, "xy".index(name[10])] if len(points) == 3 else None
    elif info.lowest < 0.0 or name == "contact_offset":
        even = tuple(scene.plane.anisotropy) == (1.0, 1.0)
        value = 0.0 if even or not name.startswith("anisotropy_") else None
    elif name == "mass":
        value = body.mass
    elif name in ("mu_support", "tripod_radius", "ellipsoid_force", "ellipsoid_torque"):
        own = "friction" if name == "mu_support" else name.split("_")[1]
        value = getattr(body.support, own, None)
    if not isinstance(value, float | int):
        raise InvalidInput(
            "derivatives",
            found=f"{name}, for which the scene has no single value",
            expected="a parameter with one value",
            hint=f"give its value in parameters={{'{name}': ...}}",
        )
    return float(value)


def _slopes(
    packed: PackedBatch,
    method: StepMethod,
    widths: FloatArray,
    pose: FloatArray,
    record: walk.ModeRecord,
    threads: int | None,
) -> tuple[FloatArray, BoolArray]:
    """Differentiate last poses by x, y and theta at the start, and by parameters changed by
    `widths`, and write the modes into `record`."""
    n, n_own = widths.shape
    stride, length = 1 + n_own, packed.units.length
    slope = np.zeros((n, 1, 3, 3 + n_own))
    found = np.zeros(n, np.int64)
    times = packed.batch.settings[::stride, DURATION, None]

    def differentiate(first: int, last: int) -> None:
        modes = np.empty(((last - first) * walk.MODE_ROOM, walk.MODE_WIDE))
        steps = np.empty(((last - first) * walk.STEP_ROOM, walk.STEP_WIDE))
        taped = stride, record, walk.Tape(modes, steps)
        walk.walk_batch(packed.batch, method, *taped, first, last)
        differentiate_batch(packed.batch, *taped, times, slope, found, first, last)

    in_ranges(differentiate, n, threads)
    slope[:, :, :2, 2:] *= length
    slope[:, :, 2, :2] /= length
    slope[..., 3:] /= widths[:, None, None]
    outline = None if packed.outline is None else packed.outline[::stride]
    ends = shape_poses(packed._replace(outline=outline), record.end[:, None, None, :3])[:, 0, 0]
    gap = np.abs(ends - pose)
    same = (gap[:, :2].max(axis=1) <= APART_LENGTH * length) & (gap[:, 2] <= APART_ANGLE)
    _refer_to_frames(slope, packed, stride, widths, pose[:, None, 2])
    return slope[:, 0], (found == 1) & same


def _refer_to_frames(
    slope: FloatArray, packed: PackedBatch, stride: int, widths: FloatArray, angle: FloatArray
) -> None:
    """Convert derivatives of and by poses of the centre of mass to those of the frame of poses,
    whose angle is `angle` (n, n_time)."""
    own = np.append(packed.com, 0.0)[None]
    if packed.outline is not None:
        centre = composed(packed.outline, own)
        own = centre[::stride]
    elif not own.any():
        return
    heading = packed.batch.pose[packed.batch.begin[::stride, BODY], 2] - own[:, 2]
    slope[..., 2] += np.einsum("ntij,nj->nti", slope[..., :2], rotated(own, heading + 0.5 * np.pi))
    lever = rotated(own[:, None], angle + 0.5 * np.pi)
    for j in range(0 if packed.outline is None else widths.shape[1]):
        moved = (centre[1 + j :: stride] - own) / widths[:, j, None]
        slope[..., 2, 3 + j] -= moved[:, None, 2]
        slope[..., :2, 3 + j] -= rotated(moved[:, None], angle)
    slope[..., :2, :] -= lever[..., None] * slope[..., 2:, :]
