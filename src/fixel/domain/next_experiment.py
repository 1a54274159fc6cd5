"""Proposals of the next experiments, by the information they add to a map.

Candidates are doubtful cells, and cells by which the domain may grow. The best cell is the one in
which another experiment is expected to reduce the entropy of the colours of the map most.
Source: Lindley (1956), on the information an experiment provides.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from fixel.domain.cells import Cells
from fixel.domain.claim import DOUBTFUL, NO_DATA, PREDICTED, CellVerdict, Claim
from fixel.domain.surface import Surface
from fixel.typing import FloatArray

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

    Parameters
    ----------
    groups : tuple of str
        Groups, one per map.
    surface : Surface
        Errors over the cells of every group.
    verdicts : list of list of CellVerdict
        Verdicts of the claim for every group and cell.
    inside : list of list of int
        Cells of the domain in every group.
    most : int
        Maximum number of proposals.
    """
    found = []
    for g, group in enumerate(groups):
        worth = _bits(surface, claim, g)
        for c in _candidates(cells, verdicts[g], inside[g]):
            reason = _reason(cells, verdicts[g][c], inside[g], c)
            found.append(
                Proposal(
                    group=group,
                    cell=c,
                    where=cells.text(c),
                    bits=float(worth[c]),
                    reason=reason,
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
        nominal = c == cells.nominal
        return (
            "no experiment at the nominal"
            if nominal
            else ("no experiment in this cell, which touches D")
        )
    touches = any(c in edge and (set(edge) & set(inside)) for edge in cells.edges)
    return f"doubtful{' and next to D' if touches else ''}: {verdict.reason}"
