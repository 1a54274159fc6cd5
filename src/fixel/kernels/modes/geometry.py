"""Contact modes of quasi-static motion, and their geometry: frames, features and gaps.

A mode states which features touch at every closed contact and whether they stick or slip, and
whether a point of the support sticks.
"""

import math
from typing import NamedTuple

import numpy as np

from fixel.kernels.arrays import GAP, N_PLACE, Model
from fixel.kernels.gap import contact_pair
from fixel.kernels.jit import allocating_kernel, kernel, large_kernel, take
from fixel.kernels.path import path_pose
from fixel.typing import FloatArray, IntArray

MOST = 4  # contacts of a mode
# Columns of `ContactMode.contact`.
FIRST = 0  # piece of the part
SECOND = 1  # piece of the obstacle
FORM = 2
ONE = 3  # vertex or edge of the part, as the number of its vertex
OTHER = 4  # the same of the obstacle
SLIP = 5  # 0: sticks; 1 or -1: friction acts along this multiple of the tangent
# Forms of contact.
TIP = 0  # a vertex or disk of the obstacle on an edge of the part
EDGE = 1  # a vertex or disk of the part on an edge of the obstacle
ROUND = 2  # a disk on a disk or a corner
FLUSH = 3  # an edge on an edge
# Entries of `ContactMode.size`.
N_CLOSED = 0
PIVOT = 1  # support element that sticks, or -1
POLE = 2  # slowest support point, or -1
ROWS = 3
# Margins: `OWN` of each contact, then those of the support, the drive and the open gaps.
OWN = 8
SUPPORT = MOST * OWN
DRIVE = SUPPORT + 1
OPEN = SUPPORT + 2
N_MARGIN = SUPPORT + 3

# Entries of `ContactMode.number`.
CLOCK_END = 0  # of the straight piece of the path
STEP_LENGTH = 1  # of the next step
LIMIT = 2  # of the drive's force
SPEED = 3  # commanded, of the pusher
PART_REACH = 4  # farthest point from the centre
PUSHER_SPEED = 5  # largest of any of its points
FRICTION = 6  # limit of the whole support
DURATION = 7
PUSHER_REACH = 8
# Numbers in the buffers of a mode, of any model.
FLOATS = 331
INTEGERS = 37


class ContactMode(NamedTuple):
    """A mode with its solution and scratch."""

    contact: IntArray  # (MOST, 6)
    size: IntArray  # (4,)
    frame: FloatArray  # (n_body, 4) cosine and sine of the angle, x and y
    origin: FloatArray  # (4,) pose of the pusher at a time of its clock, and that time
    motion: FloatArray  # (3,) its velocity from there on
    weight: FloatArray  # (n_element,) share of the friction limit
    row: FloatArray  # (6, 3) of the relative velocities that vanish
    right: FloatArray  # (6,)
    pull: FloatArray  # (6, 3) wrench for each unknown force
    push: FloatArray  # (6,) power of each unknown force at the pusher
    gap: FloatArray  # (6,) distance or angle that each row keeps at zero
    drifted: IntArray  # (6,) rows whose gap is not zero
    tangent: FloatArray  # (MOST, 4) row of the slip, and its right side
    proposed: FloatArray  # (MOST, 2) normal and tangential force of a mode that is read
    unknown: FloatArray  # (9,) slip, direction and spin about the pole; forces
    velocity: FloatArray  # (3,)
    force: FloatArray  # (6,)
    margin: FloatArray  # (N_MARGIN,)
    matrix: FloatArray  # (6, 6)
    vector: FloatArray  # (6,)
    solve: FloatArray  # (3, 3)
    dual: FloatArray  # (3, 3)
    change: FloatArray  # (6,)
    ways: FloatArray  # (3, 3) derivatives of the velocity by the unknowns
    saved: FloatArray  # (9,) unknowns at the start of a step
    before: FloatArray  # (9,) unknowns of the stage before
    floor: FloatArray  # (N_MARGIN,) by which margins may be negative
    slope: FloatArray  # (7, 3) of the stages of a step
    point: FloatArray  # (3, 4) states: end of a step, stage, inside
    world: FloatArray  # (n_vertex, 2) vertices where a gap is looked for
    place: FloatArray  # (2, N_PLACE) contacts of two pieces
    key: IntArray  # (2,)
    number: FloatArray  # (9,) see CLOCK_END
    floats: FloatArray  # what the other arrays are views of
    integers: IntArray


@allocating_kernel
def empty_mode(model: Model) -> ContactMode:
    """Allocate a mode for a model, in two buffers: each array would take as long as one solve."""
    n_body = model.friction.shape[0]
    n_element = model.element_body.size
    n_vertex = model.vertex.shape[0]
    x = np.zeros(FLOATS + 4 * n_body + n_element + 2 * n_vertex)
    i = np.zeros(INTEGERS, np.int64)
    return ContactMode(
        take(i, (MOST, 6)), take(i, (4,)), take(x, (n_body, 4)), take(x, (4,)), take(x, (3,)),
        take(x, (n_element,)), take(x, (6, 3)), take(x, (6,)), take(x, (6, 3)), take(x, (6,)),
        take(x, (6,)), take(i, (6,)), take(x, (MOST, 4)), take(x, (MOST, 2)), take(x, (9,)),
        take(x, (3,)), take(x, (6,)), take(x, (N_MARGIN,)), take(x, (6, 6)), take(x, (6,)),
        take(x, (3, 3)), take(x, (3, 3)), take(x, (6,)), take(x, (3, 3)), take(x, (9,)),
        take(x, (9,)), take(x, (N_MARGIN,)), take(x, (7, 3)), take(x, (3, 4)),
        take(x, (n_vertex, 2)), take(x, (2, N_PLACE)), take(i, (2,)), take(x, (9,)), x, i,
    )  # fmt: skip


@kernel
def place_mode(mode: ContactMode, q: FloatArray) -> None:
    """Write the frames of the part and the pusher at a state (x, y, theta, clock)."""
    set_frame(mode, 0, q[0], q[1], q[2])
    origin = mode.origin
    span = q[3] - origin[3]
    frame = mode.frame[1]
    if mode.motion[2] != 0.0:
        set_frame(mode, 1, 0.0, 0.0, origin[2] + span * mode.motion[2])
    frame[2] = origin[0] + span * mode.motion[0]
    frame[3] = origin[1] + span * mode.motion[1]


@large_kernel
def measure(model: Model, mode: ContactMode, start: FloatArray) -> None:
    """Write what does not change in a rollout that starts at these poses."""
    total = 0.0
    for e in range(model.element_limit.size):
        total += model.element_limit[e]
    for e in range(model.element_limit.size):
        mode.weight[e] = model.element_limit[e] / total
    mode.number[LIMIT] = model.force_limit[0] / total
    mode.number[FRICTION] = total
    for b in range(start.shape[0]):
        set_frame(mode, b, start[b, 0], start[b, 1], start[b, 2])
    mode.number[PART_REACH] = 0.0
    mode.number[PUSHER_REACH] = 0.0
    for p in range(model.piece_body.size):
        bound = model.piece_bound[p]
        arm = math.sqrt(bound[0] ** 2 + bound[1] ** 2) + bound[2]
        if model.piece_body[p] == 0:
            mode.number[PART_REACH] = max(mode.number[PART_REACH], arm)
        elif model.piece_body[p] == 1:
            mode.number[PUSHER_REACH] = max(mode.number[PUSHER_REACH], arm)


@large_kernel
def set_motion(model: Model, mode: ContactMode, clock: float) -> None:
    """Write the pusher's velocity on the straight piece of its path that begins or is under way,
    and when that ends."""
    number = mode.number
    until = number[DURATION]
    for k in range(model.path_start[0], model.path_start[1]):
        if model.path[k, 0] > clock + 1e-12:
            until = min(until, model.path[k, 0])
            break
    span = until - clock
    x0, y0, a0 = path_pose(model.path_start, model.path, 0, clock)
    x1, y1, a1 = path_pose(model.path_start, model.path, 0, until)
    set_frame(mode, 1, x0, y0, a0)
    mode.origin[0] = x0
    mode.origin[1] = y0
    mode.origin[2] = a0
    mode.origin[3] = clock
    motion = mode.motion
    motion[0] = (x1 - x0) / span
    motion[1] = (y1 - y0) / span
    motion[2] = (a1 - a0) / span
    number[SPEED] = math.sqrt(motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2)
    number[CLOCK_END] = until
    turning = number[PUSHER_REACH] * abs(motion[2])
    number[PUSHER_SPEED] = math.hypot(motion[0], motion[1]) + turning


@kernel
def set_frame(mode: ContactMode, body: int, x: float, y: float, angle: float) -> None:
    """Write the frame of a body."""
    mode.frame[body, 0] = math.cos(angle)
    mode.frame[body, 1] = math.sin(angle)
    mode.frame[body, 2] = x
    mode.frame[body, 3] = y


@kernel
def vertex_at(model: Model, mode: ContactMode, body: int, i: int) -> tuple[float, float]:
    """World coordinates of a vertex."""
    f = mode.frame[body]
    x = model.vertex[i, 0]
    y = model.vertex[i, 1]
    return f[2] + f[0] * x - f[1] * y, f[3] + f[1] * x + f[0] * y


@kernel
def after(model: Model, piece: int, i: int) -> int:
    """Vertex that follows on a piece."""
    return i + 1 if i + 1 < model.piece_start[piece + 1] else model.piece_start[piece]


@kernel
def before(model: Model, piece: int, i: int) -> int:
    """Vertex that precedes on a piece."""
    return i - 1 if i > model.piece_start[piece] else model.piece_start[piece + 1] - 1


@kernel
def is_disk(model: Model, piece: int) -> bool:
    """Whether a piece is one vertex with a radius."""
    return bool(model.piece_start[piece + 1] - model.piece_start[piece] == 1)


@kernel
def _lean(
    model: Model, mode: ContactMode, piece: int, i: int, k: int, nx: float, ny: float
) -> float:
    """Sine of the angle at which the edge from vertex i to its neighbour k leaves the line with
    normal (nx, ny)."""
    body = model.piece_body[piece]
    x, y = vertex_at(model, mode, body, i)
    u, v = vertex_at(model, mode, body, k)
    dx = u - x
    dy = v - y
    return (dx * nx + dy * ny) / math.sqrt(dx * dx + dy * dy)


@kernel
def place_contact(
    model: Model, mode: ContactMode, c: int
) -> tuple[float, float, float, float, float, float]:
    """Normal into the part, point, gap and, of a flush edge, angle of a contact; writes the margins
    of its features."""
    own = mode.contact[c]
    margin = mode.margin
    m = OWN * c
    one = own[FIRST]
    two = own[SECOND]
    i = own[ONE]
    j = own[OTHER]
    first = model.piece_body[one]
    second = model.piece_body[two]
    vx, vy = vertex_at(model, mode, first, i)
    wx, wy = vertex_at(model, mode, second, j)
    r1 = model.piece_radius[one]
    r2 = model.piece_radius[two]
    if own[FORM] == ROUND:
        dx = vx - wx
        dy = vy - wy
        distance = math.sqrt(dx * dx + dy * dy)
        nx = dx / distance
        ny = dy / distance
        if not is_disk(model, one):
            margin[m + 5] = _lean(model, mode, one, i, after(model, one, i), nx, ny)
            margin[m + 6] = _lean(model, mode, one, i, before(model, one, i), nx, ny)
        elif not is_disk(model, two):
            margin[m + 5] = -_lean(model, mode, two, j, after(model, two, j), nx, ny)
            margin[m + 6] = -_lean(model, mode, two, j, before(model, two, j), nx, ny)
        return nx, ny, wx + nx * r2, wy + ny * r2, distance - r1 - r2, 0.0
    # The vertex or edge of one piece on an edge of the other, here the second.
    side = 1.0
    if own[FORM] == TIP:
        one, two, i, j = two, one, j, i
        vx, vy, wx, wy = wx, wy, vx, vy
        side = -1.0
    bx, by = vertex_at(model, mode, model.piece_body[two], after(model, two, j))
    ex = bx - wx
    ey = by - wy
    length = math.sqrt(ex * ex + ey * ey)
    ex /= length
    ey /= length
    if own[FORM] != FLUSH:
        foot = (vx - wx) * ex + (vy - wy) * ey
        margin[m + 3] = foot
        margin[m + 4] = length - foot
        if not is_disk(model, one):
            margin[m + 5] = _lean(model, mode, one, i, after(model, one, i), ey, -ex)
            margin[m + 6] = _lean(model, mode, one, i, before(model, one, i), ey, -ex)
        radius = model.piece_radius[one]
        gap = (vx - wx) * ey - (vy - wy) * ex - radius
        return side * ey, -side * ex, vx - ey * radius, vy + ex * radius, gap, 0.0
    # Flush: both ends of the part's edge, along the obstacle's from its middle.
    ux, uy = vertex_at(model, mode, first, after(model, one, i))
    ox = 0.5 * (wx + bx)
    oy = 0.5 * (wy + by)
    x1 = (vx - ox) * ex + (vy - oy) * ey
    x2 = (ux - ox) * ex + (uy - oy) * ey
    margin[m + 3] = max(-0.5 * length, min(x1, x2))
    margin[m + 4] = min(0.5 * length, max(x1, x2))
    y1 = (vx - ox) * ey - (vy - oy) * ex
    y2 = (ux - ox) * ey - (uy - oy) * ex
    # The part's edge runs against the obstacle's.
    return ey, -ex, ox, oy, 0.5 * (y1 + y2), math.atan2(y2 - y1, x1 - x2)


class GapArrays(NamedTuple):
    """Arrays that gaps are computed from: a call copies every array that it is given."""

    body: IntArray
    bound: FloatArray
    start: IntArray
    radius: FloatArray
    real: IntArray
    vertex: FloatArray
    world: FloatArray
    place: FloatArray
    key: IntArray
    frame: FloatArray
    contact: IntArray
    size: IntArray


@kernel
def gap_arrays(model: Model, mode: ContactMode, n_piece: int) -> GapArrays:
    """Collect the arrays of `open_gap`, for the first pieces of a model."""
    return GapArrays(
        model.piece_body[:n_piece],
        model.piece_bound,
        model.piece_start,
        model.piece_radius,
        model.edge_real,
        model.vertex,
        mode.world,
        mode.place,
        mode.key,
        mode.frame,
        mode.contact,
        mode.size,
    )


@kernel
def place_piece(pieces: GapArrays, piece: int) -> None:
    """Write the vertices of a piece in the world."""
    f = pieces.frame[pieces.body[piece]]
    for i in range(pieces.start[piece], pieces.start[piece + 1]):
        x = pieces.vertex[i, 0]
        y = pieces.vertex[i, 1]
        pieces.world[i, 0] = f[2] + f[0] * x - f[1] * y
        pieces.world[i, 1] = f[3] + f[1] * x + f[0] * y


@large_kernel
def open_gap(pieces: GapArrays) -> float:
    """Smallest gap of the pairs that are not in contact in the mode, at its frames; at most 1."""
    smallest = 1.0
    bound = pieces.bound
    n_piece = pieces.body.size
    for one in range(n_piece):
        if pieces.body[one] != 0:
            break
        placed = False
        f = pieces.frame[0]
        cx = f[2] + f[0] * bound[one, 0] - f[1] * bound[one, 1]
        cy = f[3] + f[1] * bound[one, 0] + f[0] * bound[one, 1]
        for two in range(one + 1, n_piece):
            if pieces.body[two] == 0:
                continue
            g = pieces.frame[pieces.body[two]]
            dx = g[2] + g[0] * bound[two, 0] - g[1] * bound[two, 1] - cx
            dy = g[3] + g[1] * bound[two, 0] + g[0] * bound[two, 1] - cy
            reach = bound[one, 2] + bound[two, 2] + smallest
            if reach <= 0.0 or dx * dx + dy * dy >= reach * reach:
                continue
            closed = False
            for c in range(pieces.size[N_CLOSED]):
                if pieces.contact[c, FIRST] == one and pieces.contact[c, SECOND] == two:
                    closed = True
            if closed:
                continue
            if not placed:
                place_piece(pieces, one)
                placed = True
            place_piece(pieces, two)
            start = pieces.start
            found = contact_pair(
                pieces.world, pieces.real,
                start[one], start[one + 1], pieces.radius[one],
                start[two], start[two + 1], pieces.radius[two],
                smallest, pieces.place, pieces.key, 0,
            )  # fmt: skip
            for k in range(found):
                smallest = min(smallest, pieces.place[k, GAP])
    return smallest
