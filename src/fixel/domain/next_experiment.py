"""Proposals of the next experiments of a map, and error bounds for cells without experiments.

Candidates are doubtful cells, and cells by which the domain may grow. The best cell is the one in
which another experiment is expected to reduce the entropy of the colours of the map most.
Source: Lindley (1956), on the information an experiment provides.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import CONTACT_ANGLE, MAX_RATIO, MAX_TURN
from fixel.calibration.mixed import numbered
from fixel.domain.cells import CellAxis, Cells
from fixel.domain.claim import DOUBTFUL, NO_DATA, PREDICTED, CellVerdict, Claim
from fixel.domain.error_bound import ConformalBound, min_experiments
from fixel.domain.evidence import HeldOutErrors, Value
from fixel.domain.surface import Surface
from fixel.model import wrapped
from fixel.typing import FloatArray, IntArray
from fixel.units import split_unit

NODES: Final = 9  # nodes of the quadrature over results of the experiment


class Proposal(NamedTuple):
    """Proposed experiment."""

    group: str  # group of the map
    cell: int
    where: str  # cell as text
    bits: float  # expected decrease of the entropy of the colours of all cells of the map [bit]
    reason: str


def proposals(
    cells: Cells,
    groups: tuple[str, ...],
    surface: Surface,
    claim: Claim,
    verdicts: list[list[CellVerdict]],
    inside: list[list[int]],
    most: int = 5,
) -> list[Proposal]:
    """Return the most informative experiments over all maps, the best first.

    There is one map per group, with the verdicts of the claim and the cells `inside` the domain.
    """
    found = []
    for g, group in enumerate(groups):
        worth = _bits(surface, claim, g)
        for c in _candidates(cells, verdicts[g], inside[g]):
            reason = _reason(cells, verdicts[g][c], inside[g], c)
            found.append(
                Proposal(
                    group=group, cell=c, where=cells.text(c), bits=float(worth[c]), reason=reason
                )
            )
    return sorted(found, key=lambda one: -one.bits)[:most]


def _candidates(cells: Cells, verdicts: list[CellVerdict], inside: list[int]) -> list[int]:
    """Return doubtful cells, and cells without data next to the domain or at the nominal."""
    near = {b for a, b in cells.edges if a in inside}
    near |= {a for a, b in cells.edges if b in inside}
    near.add(cells.nominal)
    found = []
    for c, verdict in enumerate(verdicts):
        open_still = verdict.colour == DOUBTFUL
        unknown = verdict.colour in (NO_DATA, PREDICTED) and c in near
        if open_still or unknown:
            found.append(c)
    return found


def _bits(surface: Surface, claim: Claim, g: int) -> FloatArray:
    """Return the expected decrease (n_cell,) of the entropy by an experiment in each cell."""
    from scipy.special import ndtr, ndtri

    covariance = surface.covariance[g]
    scatter = float(surface.values[5])
    mean = surface.mean[0, g] + float(ndtri(claim.level)) * scatter
    variance = np.maximum(np.diag(covariance), 1e-9)
    before = _entropy(ndtr((claim.score - mean) / np.sqrt(variance)))
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights = weights / weights.sum()
    found = np.zeros(len(mean))
    for c in range(len(mean)):
        total = float(variance[c]) + scatter**2
        left = np.maximum(variance - covariance[:, c] ** 2 / total, 1e-9)
        shift = covariance[:, c] / math.sqrt(total)
        after = np.zeros(len(mean))
        for z, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
            chance = ndtr((claim.score - mean - shift * z) / np.sqrt(left))
            after += weight * _entropy(chance)
        found[c] = float((before - after).sum())
    return np.maximum(found, 0.0)


def _entropy(chance: FloatArray) -> FloatArray:
    """Return the entropy of a binary event with these probabilities [bit]."""
    p = np.clip(chance, 1e-12, 1.0 - 1e-12)
    return np.asarray(-(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)))


def _reason(cells: Cells, verdict: CellVerdict, inside: list[int], c: int) -> str:
    if verdict.colour != DOUBTFUL:
        where = "at the nominal" if c == cells.nominal else "in this cell, which touches D"
        return f"no experiment {where}"
    touches = any(c in edge and (set(edge) & set(inside)) for edge in cells.edges)
    return f"doubtful{' and next to D' if touches else ''}: {verdict.reason}"


def predicted_cells(
    evidence: HeldOutErrors, cells: Cells, level: float, seed: int = 0
) -> FloatArray | None:
    """Return bounds (n_group, n_cell) that errors of new experiments satisfy [mm].

    They apply to root mean square errors, each with the probability `level`; inf without data, or
    for coordinates that no experiment of the map has. None if there are too few experiments for any
    bound.
    """
    place = cells.find(evidence)
    known = np.flatnonzero((place >= 0) & ~np.isnan(evidence.error_mm2))
    group = numbered(evidence.group)
    # A cell without experiments is like another cell, not like another repetition in one of them.
    # So its bound uses one experiment per cell, and models have seen no other of the same cell.
    slots = {(int(group[k]), int(place[k])): k for k in reversed(known.tolist())}
    first = np.sort(np.fromiter(slots.values(), np.int64, len(slots)))
    bounds = _bounds(evidence, cells, place, known, level, seed)
    if bounds is None:
        return None
    far = np.array(list(untried(evidence, cells).values())) != ""
    bounds[far] = np.inf
    if len(first) == len(known):
        return bounds
    new = _bounds(evidence, cells, place, first, level, seed)
    tried = np.zeros(bounds.shape, bool)
    tried[tuple(zip(*slots, strict=True))] = True
    return np.where(tried | far, bounds, np.inf if new is None else new)


def untried(evidence: HeldOutErrors, cells: Cells) -> dict[str, list[str]]:
    """Return, by map, the coordinate of each cell that no experiment has; empty for none.

    New are a text that no experiment of the map has, a contact angle or speed unlike all of the
    map (as in `contacts`), and any other number outside those of the map. Such a cell is an
    extrapolation, however close it is to others.
    """
    answer = {}
    group = np.array(evidence.group)
    tried = ~np.isnan(evidence.error_mm2)
    for own in dict.fromkeys(evidence.group):
        rows = np.flatnonzero(tried & (group == own)).tolist()
        known = [[evidence.column(axis.name)[k] for k in rows] for axis in cells.axes]
        new = [
            [_is_new(axis, k, values) for k in range(len(axis))]
            for axis, values in zip(cells.axes, known, strict=True)
        ]
        answer[own] = [_untried_text(cells, c, new) for c in range(len(cells))]
    return answer


def _untried_text(cells: Cells, c: int, new: list[list[bool]]) -> str:
    said = [
        f"{axis.title} {axis.text(k)} {axis.unit}".rstrip()
        for axis, k, own in zip(cells.axes, cells.index[c], new, strict=True)
        if own[k]
    ]
    return f"never tried: {', '.join(said)}" if said else ""


def _is_new(axis: CellAxis, k: int, values: list[Value]) -> bool:
    if axis.is_text:
        return axis.labels[k] not in {str(value) for value in values if value is not None}
    known = np.array([value for value in values if isinstance(value, (int, float))], np.float64)
    if not len(known):
        return True
    low, high = axis.edges[k : k + 2] if axis.edges else (axis.centres[k],) * 2
    if axis.name == CONTACT_ANGLE:
        known = low + (known - low) % (2.0 * np.pi)
    if ((known >= low) & (known <= high)).any():
        return False
    if axis.name == CONTACT_ANGLE:
        turn = [np.abs(wrapped(known - end)).min() for end in (low, high)]
        return bool(min(turn) > MAX_TURN)
    if split_unit(axis.name)[1] == "m/s":
        return not ((known <= MAX_RATIO * high) & (low <= MAX_RATIO * known)).any()
    return bool(known.max() < low or known.min() > high)


def _bounds(
    evidence: HeldOutErrors, cells: Cells, place: IntArray, rows: IntArray, level: float, seed: int
) -> FloatArray | None:
    """Return the bounds of all cells from some of the experiments; None from too few."""
    if len(rows) < min_experiments(level):
        return None
    groups = list(dict.fromkeys(evidence.group))
    apart = len(groups) > 1
    fitted = ConformalBound.fit(
        cells.places[place[rows]],
        np.sqrt(evidence.error_mm2[rows]),
        [evidence.group[k] for k in rows.tolist()] if apart else None,
        level,
        seed,
    )
    n = len(cells)
    return np.array([fitted.bounds(cells.places, [own] * n if apart else None) for own in groups])
