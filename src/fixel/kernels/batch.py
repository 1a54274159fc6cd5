"""Many rollouts in one call, independent of each other and bit for bit of the threads."""

from fixel.kernels.arrays import Batch, BatchRecord, Model, RolloutRecord, StepMethod
from fixel.kernels.jit import allocating_kernel, entry, spliced_kernel
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


@allocating_kernel
def select(batch: Batch, r: int) -> Model:
    """Return the model of rollout r, as views of the batch's arrays."""
    a = batch.begin[r]
    z = a + batch.count[r]
    m = batch.model
    n_body = batch.count[r, BODY]
    n_row, n_column = batch.map_shape[r]
    return Model(
        m.mass[a[FREE] : z[FREE]],
        m.inertia[a[FREE] : z[FREE]],
        m.wrench[a[FREE] : z[FREE]],
        m.spring[a[FREE] : z[FREE]],
        m.drag[a[FREE] : z[FREE]],
        m.piece_body[a[PIECE] : z[PIECE]],
        m.piece_start[a[PIECE_START] : z[PIECE_START]],
        m.piece_bound[a[PIECE] : z[PIECE]],
        m.piece_radius[a[PIECE] : z[PIECE]],
        m.vertex[a[VERTEX] : z[VERTEX]],
        m.edge_real[a[VERTEX] : z[VERTEX]],
        m.friction[a[PAIR] : z[PAIR]].reshape(n_body, n_body),
        m.restitution[a[PAIR] : z[PAIR]].reshape(n_body, n_body),
        m.element_body[a[ELEMENT] : z[ELEMENT]],
        m.element_kind[a[ELEMENT] : z[ELEMENT]],
        m.element_point[a[ELEMENT] : z[ELEMENT]],
        m.element_limit[a[ELEMENT] : z[ELEMENT]],
        m.element_ratio[a[ELEMENT] : z[ELEMENT]],
        m.path_start[a[PATH_START] : z[PATH_START]],
        m.path[a[PATH] : z[PATH]],
        m.force_limit[a[DRIVEN] : z[DRIVEN]],
        m.drive_dof[a[DRIVEN] : z[DRIVEN]],
        m.plane[r],
        m.map_frame[r],
        m.map_factor[a[MAP] : z[MAP]].reshape(n_row, n_column),
        batch.sides[r],
    )


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
def select_one(batch: Batch, r: int) -> Model:
    """See `select`."""
    return select(batch, r)


@entry
def rollout_batch(
    batch: Batch, method: StepMethod, record: BatchRecord, every_step: bool, first: int, last: int
) -> None:
    """Simulate rollouts `first` to ``last - 1`` without Python's lock, for use in threads."""
    for r in range(first, last):
        _rollout_one(batch, method, record, every_step, r)
