"""Many rollouts in one call, independent of each other and bit for bit of the threads."""

import numpy as np

from fixel.kernels.arrays import Batch, BatchRecord, Model, RolloutRecord, StepMethod
from fixel.kernels.jit import entry, kernel, spliced_kernel, view
from fixel.kernels.rollout import rollout

# Families: arrays with common first rows.
FREE = 0  # mass, inertia, wrench, spring, drag, velocity
BODY = 1  # pose
PAIR = 2  # friction, restitution
PIECE = 3  # piece_body, piece_bound, piece_radius
PIECE_START = 4  # piece_start
VERTEX = 5  # vertex, edge_real
ELEMENT = 6  # element_*
DRIVEN = 7  # force_limit, drive_dof
PATH_START = 8  # path_start
PATH = 9  # path
MAP = 10  # map_factor
N_FAMILY = 11


@kernel
def select(batch: Batch, r: int) -> Model:
    """Return the model of rollout r, as views of the batch's arrays, which must outlive it."""
    a = batch.begin[r]
    n = batch.count[r]
    m = batch.model
    free, piece, vertex, body = n[FREE], n[PIECE], n[VERTEX], n[BODY]
    element, driven, cells, e = n[ELEMENT], n[DRIVEN], batch.map_shape[r], a[ELEMENT]
    return Model(
        view(m.mass, a[FREE], (free,)), view(m.inertia, a[FREE], (free,)),
        view(m.wrench, 3 * a[FREE], (free, 3)), view(m.spring, 3 * a[FREE], (free, 3)),
        view(m.drag, 9 * a[FREE], (free, 3, 3)), view(m.piece_body, a[PIECE], (piece,)),
        view(m.piece_start, a[PIECE_START], (n[PIECE_START],)),
        view(m.piece_bound, 3 * a[PIECE], (piece, 3)), view(m.piece_radius, a[PIECE], (piece,)),
        view(m.vertex, 2 * a[VERTEX], (vertex, 2)), view(m.edge_real, a[VERTEX], (vertex,)),
        view(m.friction, a[PAIR], (body, body)), view(m.restitution, a[PAIR], (body, body)),
        view(m.element_body, e, (element,)), view(m.element_kind, e, (element,)),
        view(m.element_point, 2 * e, (element, 2)), view(m.element_limit, e, (element,)),
        view(m.element_ratio, e, (element,)), view(m.path_start, a[PATH_START], (n[PATH_START],)),
        view(m.path, 4 * a[PATH], (n[PATH], 4)),
        view(m.force_limit, a[DRIVEN], (driven,)), view(m.drive_dof, a[DRIVEN], (driven,)),
        view(m.plane, 3 * r, (3,)), view(m.map_frame, 4 * r, (4,)),
        view(m.map_factor, a[MAP], (cells[0], cells[1])), batch.sides[r],
    )  # fmt: skip


@spliced_kernel
def _rollout_one(
    batch: Batch, method: StepMethod, record: BatchRecord, every_step: bool, r: int
) -> None:
    a = batch.begin[r]
    z = a + batch.count[r]
    own = RolloutRecord(
        record.time[r],
        record.pose[r],
        record.twist[r],
        record.drive[r],
        record.contact[r],
        record.count[r],
        record.total[r],
    )
    record.status[r] = rollout(
        select(batch, r),
        batch.pose[a[BODY] : z[BODY]],
        batch.velocity[a[FREE] : z[FREE]],
        method,
        batch.settings[r],
        own,
        every_step,
    )


@entry
def _select_one(batch: Batch, r: int) -> Model:
    return select(batch, r)


def select_one(batch: Batch, r: int) -> Model:
    """Return a copy of the model of rollout r."""
    shared = _select_one(batch, r)
    return Model._make([*map(np.array, shared[:-1]), shared.sides])


@entry
def rollout_batch(
    batch: Batch, method: StepMethod, record: BatchRecord, every_step: bool, first: int, last: int
) -> None:
    """Simulate rollouts `first` to ``last - 1`` without Python's lock, for use in threads."""
    for r in range(first, last):
        _rollout_one(batch, method, record, every_step, r)
