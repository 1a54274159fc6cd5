"""Signed gap, witness points and normals of a pair of convex pieces in world coordinates.

A piece is a strictly convex polygon, counter-clockwise (no straight corners), or a disk: one vertex
with a radius. The gap is the distance of the outlines, negative in overlap (then the least
translation that parts them). `contact_pair` writes one or two contacts: two where edges face each
other.

Pieces of a non-convex body meet at seams, edges that are not on the body's outline. Where a seam is
the nearest feature, or a corner seen across a seam that ends there, the neighbouring piece lies in
between and gives the true contact; so those contacts are left out. An edge that ends in a notch of
the outline extends beyond it: a corner in the notch then touches both edges in their middle, and
passes neither by rounding.

Source: separating axes and reference-edge clipping as in Gregorius, "Robust contact creation" (GDC
2015); the contacts themselves are exact vertex-edge pairs, so that their rows are the true
gradients of the gap. The nearest features lie on the edge of largest separation and the edge that
faces it: the separation along a direction is minus the support function of the Minkowski
difference, which, where positive, has a single peak, at the direction of the nearest points.
"""

import math

import numpy as np

from fixel.kernels.arrays import N_PLACE
from fixel.kernels.jit import entry, kernel
from fixel.typing import FloatArray, IntArray

# Feature codes. The vertex of the second piece counts from 0, the vertex of the first from
# FIRST_VERTEX; two corners are named by the second piece's, from VERTEX_VERTEX. At most 2**18
# vertices per piece.
VERTEX_VERTEX = 1 << 18
FIRST_VERTEX = 1 << 19
FEATURES = 1 << 20

# Length below which two corners are one point: their difference has no reliable direction, and the
# edge gives the normal. World coordinates are of order one, so this is some thousand roundings.
COINCIDENT = 1e-12
# Polygons with more edges than MANY are searched at every edge of COARSE first.
MANY = 16
COARSE = 8
# Share of an edge that lies beyond a notch. The seam at its end is flagged: -1 where it begins
# there, -2 where it ends, -3 for both ends, 0 for none.
BACK = 1.0 / 33.0
# Share of the reference edge below which the two ends of an overlap are one contact.
NARROW = 1e-9


@kernel
def contact_pair(
    world: FloatArray,
    real: IntArray,
    s1: int,
    e1: int,
    r1: float,
    s2: int,
    e2: int,
    r2: float,
    margin: float,
    place: FloatArray,
    key: IntArray,
    at: int,
) -> int:
    """Write the contacts of two pieces with gaps below `margin`; returns their number, 0 to 2.

    Piece 1 owns ``world[s1:e1]`` and has radius `r1`, which only disks may have. Row ``at`` onward
    of `place` gets gap, normal x, y (from the second piece into the first) and the contact point
    x, y (half way between the outlines), and how round either outline is there: zero for a corner,
    the radius of a disk, infinite for an edge. `key` gets the feature code. In overlap the first
    contact written has the gap of the pair, else the smaller of both.
    """
    if e1 - s1 > 1 and e2 - s2 > 1:
        return _contact_polygons(world, real, s1, e1, s2, e2, margin, place, key, at)
    # A disk: the distance from its centre to the other piece, less the radii.
    most = margin + r1 + r2
    px = world[s2, 0]
    py = world[s2, 1]
    round_1 = r1
    round_2 = r2
    if e1 - s1 == 1 and e2 - s2 == 1:
        d, nx, ny = _point_to_point(world[s1, 0] - px, world[s1, 1] - py)
    elif e1 - s1 == 1:
        d, nx, ny, round_2 = _point_to_polygon(
            world, real, s2, e2, world[s1, 0], world[s1, 1], most
        )
    else:
        d, nx, ny, round_1 = _point_to_polygon(world, real, s1, e1, px, py, most)
        nx = -nx
        ny = -ny
    if d >= most:
        return 0
    gap = d - r1 - r2
    if e1 - s1 == 1:
        # From the first disk's centre, which is exact, to the witness on the second outline.
        px = world[s1, 0] - nx * (d - r2)
        py = world[s1, 1] - ny * (d - r2)
    else:
        px += nx * r2
        py += ny * r2
    _write(place, key, at, gap, nx, ny, px, py, 0, round_1, round_2, math.inf, math.inf)
    return 1


@kernel
def _write(
    place: FloatArray,
    key: IntArray,
    at: int,
    gap: float,
    nx: float,
    ny: float,
    px: float,
    py: float,
    code: int,
    round_1: float,
    round_2: float,
    to_start: float,
    to_end: float,
) -> None:
    """Write one contact, from the witness point (px, py) on the second outline."""
    place[at, 0] = gap
    place[at, 1] = nx
    place[at, 2] = ny
    place[at, 3] = px + nx * 0.5 * gap
    place[at, 4] = py + ny * 0.5 * gap
    place[at, 5] = round_1
    place[at, 6] = round_2
    place[at, 9] = to_start
    place[at, 10] = to_end
    key[at] = code


@kernel
def _point_to_point(dx: float, dy: float) -> tuple[float, float, float]:
    """Length and direction of a vector; x for zero length, as for concentric disks."""
    distance = math.sqrt(dx * dx + dy * dy)
    if distance < COINCIDENT:
        return 0.0, 1.0, 0.0
    return distance, dx / distance, dy / distance


@kernel
def _point_to_polygon(
    world: FloatArray, real: IntArray, start: int, end: int, px: float, py: float, most: float
) -> tuple[float, float, float, float]:
    """Signed distance and outward normal from a convex polygon to a point, and the radius of its
    outline there: zero for a corner, infinite for an edge.

    Returns (most, 0, 0, 0) where the distance is at least `most`, or the shortest way crosses a
    seam.
    """
    best = -math.inf  # over all edges
    edge = start
    inside = -math.inf  # over those on the outline: a point inside leaves through one of them
    way_out = -1
    bound = -math.inf
    before = end - 1
    for i in range(start, end):
        # The edge from `before` to i.
        ex = world[i, 0] - world[before, 0]
        ey = world[i, 1] - world[before, 1]
        square = ex * ex + ey * ey
        s = (px - world[before, 0]) * ey - (py - world[before, 1]) * ex
        if s * abs(s) < bound * square:
            before = i
            continue
        s /= math.sqrt(square)
        if s >= most:
            return most, 0.0, 0.0, 0.0
        if s > best:
            best = s
            edge = before
        if s > inside and real[before] == 1:
            inside = s
            bound = _signed_square(s)
            way_out = before
        before = i
    if best <= 0.0:
        best = inside
        edge = way_out
    if edge < 0 or real[edge] < 1:
        return most, 0.0, 0.0, 0.0
    after = edge + 1 if edge + 1 < end else start
    ex = world[after, 0] - world[edge, 0]
    ey = world[after, 1] - world[edge, 1]
    square = ex * ex + ey * ey
    length = math.sqrt(square)
    if best > 0.0:
        along = (px - world[edge, 0]) * ex + (py - world[edge, 1]) * ey
        if along < 0.0 or along > square:
            corner = edge if along < 0.0 else after
            dx = px - world[corner, 0]
            dy = py - world[corner, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if distance >= most or _beyond_seam(world, real, start, end, corner, px, py):
                return most, 0.0, 0.0, 0.0
            if distance > COINCIDENT:
                return distance, dx / distance, dy / distance, 0.0
    return best, ey / length, -ex / length, math.inf


@kernel
def _beyond_seam(
    world: FloatArray, real: IntArray, start: int, end: int, corner: int, px: float, py: float
) -> bool:
    """Whether the line from a point to a corner of a piece crosses a seam that ends there.

    Never do both pieces at a seam return True: they compute the same number except for its sign,
    or, where an edge is extended, allow for rounding.
    """
    x = px - world[corner, 0]
    y = py - world[corner, 1]
    before = corner - 1 if corner > start else end - 1
    after = corner + 1 if corner + 1 < end else start
    if real[before] < 1:
        wall = before - 1 if before > start else end - 1
        if _past_seam(world, corner, before, wall, -real[before] % 2 == 1, x, y) < 0.0:
            return True
    wall = after + 1 if after + 1 < end else start
    return bool(
        real[corner] < 1 and _past_seam(world, corner, after, wall, real[corner] < -1, x, y) > 0.0
    )


@kernel
def _past_seam(
    world: FloatArray, corner: int, far: int, wall: int, extended: bool, x: float, y: float
) -> float:
    """Cross product of (x, y) with a seam from a corner, zero within rounding.

    The seam ends in the notch where the edge there, which comes from vertex `wall`, is extended.
    """
    ex = world[far, 0] - world[corner, 0]
    ey = world[far, 1] - world[corner, 1]
    if not extended:
        return x * ey - y * ex
    ex -= BACK * (world[far, 0] - world[wall, 0])
    ey -= BACK * (world[far, 1] - world[wall, 1])
    past = x * ey - y * ex
    return past if abs(past) > COINCIDENT * (abs(x) + abs(y) + abs(ex) + abs(ey)) else 0.0


@kernel
def separating_edge(
    world: FloatArray, s1: int, e1: int, s2: int, e2: int, start: int, floor: float, margin: float
) -> tuple[float, int, int]:
    """Find the edge of polygon 1 farthest from polygon 2: separation, edge, nearest vertex.

    Returns the first edge found whose separation reaches `margin`, and edge -1 where all are below
    `floor`. No edge is farther than any vertex of polygon 2 is from it. So one vertex, `start` and
    then the nearest to the best edge so far, rules out most edges.
    """
    best = floor
    bound = _signed_square(best)
    edge = -1
    nearest = start
    coarse = e1 - s1 > MANY
    # Few edges, spread over the outline, find a good one first.
    for stride in range(COARSE if coarse else 1, 0, 1 - COARSE):
        for i in range(s1, e1, stride):
            after = i + 1 if i + 1 < e1 else s1
            x = world[i, 0]
            y = world[i, 1]
            ex = world[after, 0] - x
            ey = world[after, 1] - y
            square = ex * ex + ey * ey
            s = (world[nearest, 0] - x) * ey - (world[nearest, 1] - y) * ex
            if s * abs(s) < bound * square:
                continue
            k, s = _nearest_vertex(world, s2, e2, nearest, x, y, ex, ey)
            s /= math.sqrt(square)
            if s > best or (s == best and (edge < 0 or i < edge)):
                best = s
                bound = _signed_square(best)
                edge = i
                nearest = k
                if s >= margin:
                    return best, edge, nearest
    return best, edge, nearest


@kernel
def _signed_square(distance: float) -> float:
    """Square of a distance with its sign, lowered by more than rounding can change."""
    lowered = distance - 1e-12 * abs(distance)
    return lowered * abs(lowered)


@kernel
def _nearest_vertex(
    world: FloatArray, start: int, end: int, k: int, x: float, y: float, ex: float, ey: float
) -> tuple[int, float]:
    """Find the vertex with the least distance from a line, downhill from vertex k.

    On a convex polygon the distance has one valley. Returns the vertex, the first of two equally
    near ones, and its distance times the length of (ex, ey).
    """
    least = (world[k, 0] - x) * ey - (world[k, 1] - y) * ex
    for direction in range(2):
        origin = k
        while True:
            if direction == 0:
                other = k + 1 if k + 1 < end else start
            else:
                other = k - 1 if k > start else end - 1
            s = (world[other, 0] - x) * ey - (world[other, 1] - y) * ex
            if not (s < least or (s == least and other < k)):
                break
            k = other
            least = s
        if k != origin:
            break
    return k, least


@kernel
def _contact_polygons(
    world: FloatArray,
    real: IntArray,
    s1: int,
    e1: int,
    s2: int,
    e2: int,
    margin: float,
    place: FloatArray,
    key: IntArray,
    at: int,
) -> int:
    """Write contacts of two polygons: of the best separating edge and the edge that faces it."""
    sep1, edge1, support1 = separating_edge(world, s1, e1, s2, e2, s2, -math.inf, margin)
    if sep1 >= margin:
        return 0
    sep2, edge2, support2 = separating_edge(world, s2, e2, s1, e1, edge1, sep1, margin)
    if sep2 >= margin:
        return 0
    # The reference edge is the one of larger separation; ties go to the second polygon, unless its
    # edge is a seam.
    on_first = edge2 < 0 or (sep1 == sep2 and real[edge2] < 1)
    if on_first:
        sep, rs, re, fs, fe, edge, support = sep1, s1, e1, s2, e2, edge1, support1
    else:
        sep, rs, re, fs, fe, edge, support = sep2, s2, e2, s1, e1, edge2, support2
    if real[edge] < 1:
        # The piece on the other side of the seam has the contacts.
        return 0
    flip = -1.0 if on_first else 1.0
    x0 = world[edge, 0]
    y0 = world[edge, 1]
    after = edge + 1 if edge + 1 < re else rs
    tx = world[after, 0] - x0
    ty = world[after, 1] - y0
    length = math.sqrt(tx * tx + ty * ty)
    tx /= length
    ty /= length
    nx = ty
    ny = -tx
    i1, i2 = _facing_edge(world, fs, fe, support, nx, ny)
    # Along the reference edge the facing edge runs backwards, from c1 down to c2.
    c1 = (world[i1, 0] - x0) * tx + (world[i1, 1] - y0) * ty
    c2 = (world[i2, 0] - x0) * tx + (world[i2, 1] - y0) * ty
    overlap = min(c1, length) - max(c2, 0.0)
    n = 0
    for end in range(2 if overlap > NARROW * length else 1):
        # The end at the support vertex comes first: it has the nearest features.
        upper = (support == i1) == (end == 0)
        if overlap < 0.0:
            upper = c2 > length
        on_facing = overlap >= 0.0 and (c1 <= length if upper else c2 >= 0.0)
        ox = nx
        oy = ny
        vertex = i1 if upper else i2
        other = -1  # the second corner of a corner-corner contact
        along = c1 if upper else c2  # where on its edge the foot of the vertex lies
        whole = length
        if on_facing:
            gap = (world[vertex, 0] - x0) * nx + (world[vertex, 1] - y0) * ny
        else:
            vertex = after if upper else edge
            gap, ox, oy, other, along, whole = _corner_to_edge(world, vertex, i1, i2)
            if other < 0:
                if real[i1] < 1:
                    continue
            elif end == 1:
                continue
            elif sep <= 0.0 or gap <= COINCIDENT:
                # Only rounding put the foot outside: the support vertex is on the reference edge.
                on_facing = True
                vertex = support
                other = -1
                gap, ox, oy = sep, nx, ny
                along = whole = math.inf
            elif _beyond_seam(world, real, rs, re, vertex, world[other, 0], world[other, 1]) or (
                _beyond_seam(world, real, fs, fe, other, world[vertex, 0], world[vertex, 1])
            ):
                return 0
        if gap >= margin:
            continue
        if (re - rs if on_facing else fe - fs) > MANY:
            along = whole = math.inf  # nearly round: no corner is an event
        ox *= flip
        oy *= flip
        if other >= 0:
            # Corner against corner, named by the second piece's.
            vertex = other if on_first else vertex
            code = VERTEX_VERTEX + vertex - s2
            back = 0.0
            round_1 = round_2 = 0.0
            along = whole = math.inf
        elif on_facing == on_first:
            code = vertex - s2
            back = 0.0
            round_1 = math.inf
            round_2 = 0.0
        else:
            # The first piece's vertex: its foot is the witness on the second outline.
            code = FIRST_VERTEX + vertex - s1
            back = gap
            round_1 = 0.0
            round_2 = math.inf
        _write(
            place, key, at + n, gap, ox, oy, world[vertex, 0] - ox * back,
            world[vertex, 1] - oy * back, code, round_1, round_2,
            along, whole - along if along < math.inf else math.inf,
        )  # fmt: skip
        n += 1
    return n


@kernel
def _corner_to_edge(
    world: FloatArray, corner: int, i1: int, i2: int
) -> tuple[float, float, float, int, float, float]:
    """Gap and direction from a corner to the edge i1 to i2 or its nearer end; that end or -1; how
    far along the edge the corner is, and the length of the edge."""
    dx = world[corner, 0] - world[i1, 0]
    dy = world[corner, 1] - world[i1, 1]
    ex = world[i2, 0] - world[i1, 0]
    ey = world[i2, 1] - world[i1, 1]
    along = dx * ex + dy * ey
    square = ex * ex + ey * ey
    if 0.0 <= along <= square:
        length = math.sqrt(square)
        gap = (dx * ey - dy * ex) / length
        return gap, -ey / length, ex / length, -1, along / length, length
    other = i1 if along < 0.0 else i2
    dx = world[other, 0] - world[corner, 0]
    dy = world[other, 1] - world[corner, 1]
    distance = math.sqrt(dx * dx + dy * dy)
    return distance, dx / distance, dy / distance, other, math.inf, math.inf


@kernel
def _facing_edge(
    world: FloatArray, start: int, end: int, support: int, nx: float, ny: float
) -> tuple[int, int]:
    """Choose the edge at the support vertex that is more nearly opposite to the normal."""
    before = support - 1 if support > start else end - 1
    after = support + 1 if support + 1 < end else start
    ax = world[support, 0] - world[before, 0]
    ay = world[support, 1] - world[before, 1]
    bx = world[after, 0] - world[support, 0]
    by = world[after, 1] - world[support, 1]
    lean_a = (ay * nx - ax * ny) / math.sqrt(ax * ax + ay * ay)
    lean_b = (by * nx - bx * ny) / math.sqrt(bx * bx + by * by)
    if lean_a < lean_b:
        return before, support
    return support, after


@entry
def measure_gaps(
    vertex: FloatArray,
    edge_real: IntArray,
    piece_start: IntArray,
    piece_radius: FloatArray,
    shape_start: IntArray,
    first: IntArray,
    second: IntArray,
    first_pose: FloatArray,
    second_pose: FloatArray,
) -> FloatArray:
    """Compute gap, normal and contact point of many pairs of shapes, for Python.

    Simulations do not use it; they find contacts with `contacts.find_contacts`.

    Parameters
    ----------
    vertex, edge_real, piece_start, piece_radius
        Convex pieces in their shapes' frames, as in `arrays.Model`.
    shape_start : (n_shape + 1,) int64
        Shape i owns the pieces from ``shape_start[i]`` to ``shape_start[i + 1]``.
    first, second : (n,) int64
        Indices of the shapes of each pair.
    first_pose, second_pose : (n, 3) float64
        Poses of the shapes.

    Returns
    -------
    (n, 5) float64
        Gap, normal x, y (from the second shape into the first), and the point x, y half way between
        the witnesses.

    Notes
    -----
    For overlapping shapes that are not convex, this is the deepest contact of their pieces.
    """
    n = first.size
    found = np.empty((n, 5))
    world = np.empty((2 * vertex.shape[0], 2))
    # A shape may be paired with itself, so each side of a pair uses its own half of the scratch.
    half = vertex.shape[0]
    real = np.concatenate((edge_real, edge_real))
    whole = np.ones_like(real)
    place = np.empty((2, N_PLACE))
    key = np.empty(2, np.int64)
    for i in range(n):
        a = first[i]
        b = second[i]
        _place_shape(vertex, piece_start, shape_start, a, first_pose[i], world, 0)
        _place_shape(vertex, piece_start, shape_start, b, second_pose[i], world, half)
        found[i, 0] = math.inf
        _nearest_pieces(
            world, real, piece_start, piece_radius, shape_start, a, b, half, place, key, found[i]
        )
        if (
            found[i, 0] > -COINCIDENT
            and shape_start[a + 1] - shape_start[a] + shape_start[b + 1] - shape_start[b] > 2
        ):
            # No contact on the outline overlaps. One shape may lie within the other, on a seam.
            gap = found[i, 0]
            found[i, 0] = -COINCIDENT
            _nearest_pieces(
                world, whole, piece_start, piece_radius, shape_start, a, b, half, place, key,
                found[i],
            )  # fmt: skip
            if found[i, 0] == -COINCIDENT:
                found[i, 0] = gap
    return found


@kernel
def _place_shape(
    vertex: FloatArray,
    piece_start: IntArray,
    shape_start: IntArray,
    shape: int,
    pose: FloatArray,
    world: FloatArray,
    offset: int,
) -> None:
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    for i in range(piece_start[shape_start[shape]], piece_start[shape_start[shape + 1]]):
        world[offset + i, 0] = pose[0] + c * vertex[i, 0] - s * vertex[i, 1]
        world[offset + i, 1] = pose[1] + s * vertex[i, 0] + c * vertex[i, 1]


@kernel
def _nearest_pieces(
    world: FloatArray,
    real: IntArray,
    piece_start: IntArray,
    piece_radius: FloatArray,
    shape_start: IntArray,
    a: int,
    b: int,
    half: int,
    place: FloatArray,
    key: IntArray,
    found: FloatArray,
) -> None:
    """Write the contact of least gap of two shapes into `found`, if below the gap there."""
    for p in range(shape_start[a], shape_start[a + 1]):
        for q in range(shape_start[b], shape_start[b + 1]):
            n = contact_pair(
                world, real,
                piece_start[p], piece_start[p + 1], piece_radius[p],
                half + piece_start[q], half + piece_start[q + 1], piece_radius[q],
                found[0], place, key, 0,
            )  # fmt: skip
            if n > 0:
                for k in range(5):
                    found[k] = place[0, k]
