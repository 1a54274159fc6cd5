"""Signed gap, witness points and normals of one pair of convex pieces in world coordinates.

A piece is a convex polygon, counter-clockwise, with a rounding radius; a disk is one vertex with a radius.
The gap is the distance of the outlines, negative in overlap (then the least translation that parts them,
found along edge normals). `contact_pair` writes one or two contacts: two where edges face each other.

Source: separating axes and reference-edge clipping as in Gregorius, "Robust contact creation" (GDC 2015);
the contacts themselves are exact vertex-edge pairs, so that their rows are the true gradients of the gap.
"""

import math

from fixel.kernels.arrays import FloatArray, IntArray
from fixel.kernels.jit import kernel

VERTEX_VERTEX = 512  # feature codes: 0..511 vertex of the second piece, 1024.. vertex of the first
FIRST_VERTEX = 1024


@kernel
def _nearest_on_polygon(
    world: FloatArray, real: IntArray, start: int, end: int, px: float, py: float, margin: float
) -> tuple[float, float, float]:
    """Signed distance and outward normal from a convex polygon to a point.

    Edges that are seams between pieces do not count as faces while the point is outside some real one.
    Returns (margin, 0, 0) at once where the distance is at least `margin`.
    """
    best = -math.inf
    edge = start
    for i in range(start, end):
        j = i + 1 if i + 1 < end else start
        ex = world[j, 0] - world[i, 0]
        ey = world[j, 1] - world[i, 1]
        length = math.sqrt(ex * ex + ey * ey)
        s = ((px - world[i, 0]) * ey - (py - world[i, 1]) * ex) / length
        if s >= margin:
            return margin, 0.0, 0.0
        if s > best and (real[i] == 1 or s > 0.0):
            best = s
            edge = i
    j = edge + 1 if edge + 1 < end else start
    ex = world[j, 0] - world[edge, 0]
    ey = world[j, 1] - world[edge, 1]
    square = ex * ex + ey * ey
    length = math.sqrt(square)
    if best > 0.0:
        u = ((px - world[edge, 0]) * ex + (py - world[edge, 1]) * ey) / square
        corner = -1
        if u < 0.0:
            corner = edge
        elif u > 1.0:
            corner = j
        if corner >= 0:
            dx = px - world[corner, 0]
            dy = py - world[corner, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            return distance, dx / distance, dy / distance
    return best, ey / length, -ex / length


@kernel
def _separating_edge(
    world: FloatArray, real: IntArray, s1: int, e1: int, s2: int, e2: int, margin: float
) -> tuple[float, int, int]:
    """Edge of the first polygon from which the second is farthest: (separation, edge, nearest vertex)."""
    best = -math.inf
    edge = -1
    support = s2
    for i in range(s1, e1):
        j = i + 1 if i + 1 < e1 else s1
        ex = world[j, 0] - world[i, 0]
        ey = world[j, 1] - world[i, 1]
        length = math.sqrt(ex * ex + ey * ey)
        nx = ey / length
        ny = -ex / length
        offset = nx * world[i, 0] + ny * world[i, 1]
        least = math.inf
        nearest = s2
        for k in range(s2, e2):
            s = nx * world[k, 0] + ny * world[k, 1]
            if s < least:
                least = s
                nearest = k
        least -= offset
        if least >= margin:
            return least, i, nearest
        if least > best and (real[i] == 1 or least > 0.0):
            best = least
            edge = i
            support = nearest
    return best, edge, support


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
    """Write the contacts of one pair of pieces whose gap is below `margin`; returns how many (0, 1, 2).

    Row ``at`` onward of `place` gets gap, normal x, y (from the second piece into the first) and the contact
    point x, y (half way between the outlines); `key` gets the feature code.
    """
    if e1 - s1 == 1 and e2 - s2 == 1:
        dx = world[s1, 0] - world[s2, 0]
        dy = world[s1, 1] - world[s2, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        gap = distance - r1 - r2
        if gap >= margin:
            return 0
        nx = dx / distance if distance > 0.0 else 1.0
        ny = dy / distance if distance > 0.0 else 0.0
        return _write(place, key, at, gap, nx, ny, world[s2, 0], world[s2, 1], r2, 0)
    if e1 - s1 == 1:
        px = world[s1, 0]
        py = world[s1, 1]
        d, nx, ny = _nearest_on_polygon(world, real, s2, e2, px, py, margin + r1 + r2)
        gap = d - r1 - r2
        if gap >= margin:
            return 0
        return _write(place, key, at, gap, nx, ny, px - nx * d, py - ny * d, r2, 0)
    if e2 - s2 == 1:
        px = world[s2, 0]
        py = world[s2, 1]
        d, nx, ny = _nearest_on_polygon(world, real, s1, e1, px, py, margin + r1 + r2)
        gap = d - r1 - r2
        if gap >= margin:
            return 0
        return _write(place, key, at, gap, -nx, -ny, px, py, r2, 0)
    return _contact_polygons(world, real, s1, e1, s2, e2, margin, place, key, at)


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
    beyond: float,
    code: int,
) -> int:
    """One contact: the point lies half the gap beyond the second outline, `beyond` from (px, py)."""
    place[at, 0] = gap
    place[at, 1] = nx
    place[at, 2] = ny
    place[at, 3] = px + nx * (beyond + 0.5 * gap)
    place[at, 4] = py + ny * (beyond + 0.5 * gap)
    key[at] = code
    return 1


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
    """Contacts of two convex polygons: clip the facing edge of one against the separating edge of the other."""
    sep1, edge1, support1 = _separating_edge(world, real, s1, e1, s2, e2, margin)
    if sep1 >= margin:
        return 0
    sep2, edge2, support2 = _separating_edge(world, real, s2, e2, s1, e1, margin)
    if sep2 >= margin:
        return 0
    if edge1 < 0 and edge2 < 0:
        return 0
    # The reference edge belongs to the polygon that separates better; ties go to the second.
    on_first = sep1 > sep2
    if on_first:
        rs, re, ins, ine, edge, support = s1, e1, s2, e2, edge1, support1
    else:
        rs, re, ins, ine, edge, support = s2, e2, s1, e1, edge2, support2
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
    # The facing edge: of the two at the support vertex, the one that leans more against the normal.
    before = support - 1 if support > ins else ine - 1
    behind = support + 1 if support + 1 < ine else ins
    ax = world[support, 0] - world[before, 0]
    ay = world[support, 1] - world[before, 1]
    bx = world[behind, 0] - world[support, 0]
    by = world[behind, 1] - world[support, 1]
    lean_a = (ay * nx - ax * ny) / math.sqrt(ax * ax + ay * ay)
    lean_b = (by * nx - bx * ny) / math.sqrt(bx * bx + by * by)
    if lean_a < lean_b:
        i1, i2 = before, support
    else:
        i1, i2 = support, behind
    # Along the reference edge the facing edge runs backwards, from c1 down to c2.
    c1 = (world[i1, 0] - x0) * tx + (world[i1, 1] - y0) * ty
    c2 = (world[i2, 0] - x0) * tx + (world[i2, 1] - y0) * ty
    if c2 > length or c1 < 0.0:
        # They pass each other by: corner against corner, unless the pieces overlap.
        if max(sep1, sep2) > 0.0:
            return _contact_corners(world, s1, e1, s2, e2, margin, place, key, at)
        gap = (world[support, 0] - x0) * nx + (world[support, 1] - y0) * ny
        return _write(
            place, key, at, gap, flip * nx, flip * ny,
            world[support, 0] - (nx * gap if not on_first else 0.0),
            world[support, 1] - (ny * gap if not on_first else 0.0),
            0.0, _vertex_code(support, s1, s2, not on_first),
        )  # fmt: skip
    ix = world[i2, 0] - world[i1, 0]
    iy = world[i2, 1] - world[i1, 1]
    il = math.sqrt(ix * ix + iy * iy)
    mx = iy / il
    my = -ix / il
    n = 0
    for end in range(2):
        # Upper end of the overlap: vertex i1, or the reference edge's far corner; lower end: i2 or its near one.
        if end == 0:
            use_facing = c1 <= length
            vertex = i1 if use_facing else after
        else:
            use_facing = c2 >= 0.0
            vertex = i2 if use_facing else edge
        vx = world[vertex, 0]
        vy = world[vertex, 1]
        if use_facing:
            gap = (vx - x0) * nx + (vy - y0) * ny
            ox, oy = nx, ny
        else:
            gap = (vx - world[i1, 0]) * mx + (vy - world[i1, 1]) * my
            ox, oy = -mx, -my
        if gap >= margin:
            continue
        vertex_on_first = use_facing != on_first
        px = vx
        py = vy
        if vertex_on_first:
            # The foot of the first piece's vertex on the second outline.
            px -= flip * ox * gap
            py -= flip * oy * gap
        n += _write(
            place, key, at + n, gap, flip * ox, flip * oy, px, py, 0.0,
            _vertex_code(vertex, s1, s2, vertex_on_first),
        )  # fmt: skip
    return n


@kernel
def _vertex_code(vertex: int, s1: int, s2: int, on_first: bool) -> int:
    return FIRST_VERTEX + vertex - s1 if on_first else vertex - s2


@kernel
def _contact_corners(
    world: FloatArray,
    s1: int,
    e1: int,
    s2: int,
    e2: int,
    margin: float,
    place: FloatArray,
    key: IntArray,
    at: int,
) -> int:
    """The one contact of two polygons that are apart and whose edges do not face each other."""
    best = margin
    bx = 0.0
    by = 0.0
    px = 0.0
    py = 0.0
    code = -1
    for side in range(2):
        vs, ve, ps, pe = (s1, e1, s2, e2) if side == 0 else (s2, e2, s1, e1)
        for i in range(vs, ve):
            for j in range(ps, pe):
                k = j + 1 if j + 1 < pe else ps
                ex = world[k, 0] - world[j, 0]
                ey = world[k, 1] - world[j, 1]
                dx = world[i, 0] - world[j, 0]
                dy = world[i, 1] - world[j, 1]
                u = min(1.0, max(0.0, (dx * ex + dy * ey) / (ex * ex + ey * ey)))
                dx -= u * ex
                dy -= u * ey
                distance = math.sqrt(dx * dx + dy * dy)
                if distance < best:
                    best = distance
                    sign = 1.0 if side == 0 else -1.0
                    bx = sign * dx
                    by = sign * dy
                    px = world[i, 0] - dx if side == 0 else world[i, 0]
                    py = world[i, 1] - dy if side == 0 else world[i, 1]
                    code = VERTEX_VERTEX + _vertex_code(i, s1, s2, side == 0)
    if code < 0 or best <= 0.0:
        return 0
    return _write(place, key, at, best, bx / best, by / best, px, py, 0.0, code)
