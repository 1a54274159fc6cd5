"""Contacts of a whole configuration: broad phase, narrow phase and warm start.

Sweep and prune along x gives the pairs whose bounding circles come within a reach. The list is
valid until a body has moved half that reach (a Verlet list), so that most steps check only a few
pairs.
"""

import math

from fixel.kernels.arrays import Model, Problem, Workspace
from fixel.kernels.gap import FEATURES, contact_pair
from fixel.kernels.jit import kernel, large_kernel
from fixel.typing import FloatArray, IntArray


@kernel
def place_bodies(model: Model, pose: FloatArray, n_body: int, work: Workspace) -> None:
    """Write the circles of the pieces of the first `n_body` bodies; `find_contacts` places the
    vertices of pieces that may touch."""
    last = -1
    for piece in range(model.piece_body.size):
        body = model.piece_body[piece]
        if body >= n_body:
            break
        frame = work.frame[body]
        if body != last:
            frame[0] = math.cos(pose[body, 2])
            frame[1] = math.sin(pose[body, 2])
            frame[2] = pose[body, 0]
            frame[3] = pose[body, 1]
            last = body
        bx = model.piece_bound[piece, 0]
        by = model.piece_bound[piece, 1]
        work.extent[piece, 0] = frame[2] + frame[0] * bx - frame[1] * by
        work.extent[piece, 1] = frame[3] + frame[1] * bx + frame[0] * by
        work.is_placed[piece] = 0


@kernel
def _place_vertices(model: Model, piece: int, work: Workspace) -> None:
    """Write the world coordinates of a piece, unless they are those of the present pose."""
    if work.is_placed[piece] == 1:
        return
    work.is_placed[piece] = 1
    frame = work.frame[model.piece_body[piece]]
    c = frame[0]
    s = frame[1]
    x = frame[2]
    y = frame[3]
    for i in range(model.piece_start[piece], model.piece_start[piece + 1]):
        vx = model.vertex[i, 0]
        vy = model.vertex[i, 1]
        work.world[i, 0] = x + c * vx - s * vy
        work.world[i, 1] = y + s * vx + c * vy


@kernel
def moved(model: Model, pose: FloatArray, anchor: FloatArray, n_moving: int) -> float:
    """Upper bound of the travel of any point of a moving piece since the anchor poses."""
    farthest = 0.0
    for piece in range(model.piece_body.size):
        body = model.piece_body[piece]
        if body >= n_moving:
            break
        bound = model.piece_bound[piece]
        arm = math.sqrt(bound[0] * bound[0] + bound[1] * bound[1]) + bound[2]
        dx = pose[body, 0] - anchor[body, 0]
        dy = pose[body, 1] - anchor[body, 1]
        moved = math.sqrt(dx * dx + dy * dy) + arm * abs(pose[body, 2] - anchor[body, 2])
        farthest = max(farthest, moved)
    return farthest


@large_kernel
def find_near_pairs(
    model: Model, pose: FloatArray, n_free: int, n_moving: int, reach: float, work: Workspace
) -> int:
    """List the pairs of pieces within `reach`, at least one on a free body; returns their number.

    Pairs are sorted by (first piece, second piece). Returns -1 where the list is too short.
    """
    n_piece = model.piece_body.size
    order = work.order
    extent = work.extent
    for i in range(n_piece):
        # Insertion sort by left edge: the order of the last call is nearly right.
        piece = order[i]
        left = extent[piece, 0] - extent[piece, 2]
        j = i - 1
        while j >= 0 and extent[order[j], 0] - extent[order[j], 2] > left:
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = piece
    n = 0
    for i in range(n_piece):
        p = order[i]
        right = extent[p, 0] + extent[p, 2] + reach
        for j in range(i + 1, n_piece):
            q = order[j]
            if extent[q, 0] - extent[q, 2] > right:
                break
            a = min(p, q)
            b = max(p, q)
            if model.piece_body[a] >= n_free or model.piece_body[a] == model.piece_body[b]:
                continue
            dx = extent[p, 0] - extent[q, 0]
            dy = extent[p, 1] - extent[q, 1]
            most = extent[p, 2] + extent[q, 2] + reach
            if dx * dx + dy * dy < most * most:
                if n == work.near.shape[0]:
                    return -1
                # Insert in order, independently of the sweep's.
                k = n - 1
                while k >= 0 and (
                    work.near[k, 0] > a or (work.near[k, 0] == a and work.near[k, 1] > b)
                ):
                    work.near[k + 1, 0] = work.near[k, 0]
                    work.near[k + 1, 1] = work.near[k, 1]
                    k -= 1
                work.near[k + 1, 0] = a
                work.near[k + 1, 1] = b
                n += 1
    for body in range(n_moving):
        for k in range(3):
            work.anchor[body, k] = pose[body, k]
    return n


@kernel
def find_contacts(
    model: Model, n_near: int, margin: float, problem: Problem, work: Workspace
) -> int:
    """Write key, bodies and place of every contact with a gap below `margin`; -1 for no room."""
    n = 0
    n_piece = model.piece_body.size
    for k in range(n_near):
        i = work.near[k, 0]
        j = work.near[k, 1]
        dx = work.extent[i, 0] - work.extent[j, 0]
        dy = work.extent[i, 1] - work.extent[j, 1]
        most = work.extent[i, 2] + work.extent[j, 2] + margin
        if dx * dx + dy * dy >= most * most:
            continue
        if n + 2 > problem.contact_key.size:
            return -1
        _place_vertices(model, i, work)
        _place_vertices(model, j, work)
        found = contact_pair(
            work.world, model.edge_real,
            model.piece_start[i], model.piece_start[i + 1], model.piece_radius[i],
            model.piece_start[j], model.piece_start[j + 1], model.piece_radius[j],
            margin, problem.contact_place, problem.contact_key, n,
        )  # fmt: skip
        for c in range(n, n + found):
            problem.contact_key[c] += (i * n_piece + j) * FEATURES
            problem.contact_body[c, 0] = model.piece_body[i]
            problem.contact_body[c, 1] = model.piece_body[j]
        n += found
    return n


@kernel
def warm_start(
    problem: Problem,
    n_contact: int,
    old_key: IntArray,
    old_impulse: FloatArray,
    n_old: int,
    ratio: float,
) -> None:
    """Set the impulse of every contact to that of its features in the last step taken, times
    `ratio`.

    Both lists are sorted by pair of pieces; within a pair there are one or two.
    """
    cursor = 0
    for i in range(n_contact):
        key = problem.contact_key[i]
        pair = key // FEATURES
        while cursor < n_old and old_key[cursor] // FEATURES < pair:
            cursor += 1
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
        k = cursor
        while k < n_old and old_key[k] // FEATURES == pair:
            if old_key[k] == key:
                problem.impulse[i, 0] = ratio * old_impulse[k, 0]
                problem.impulse[i, 1] = ratio * old_impulse[k, 1]
                break
            k += 1
