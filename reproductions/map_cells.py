"""Pushes in trusted cells of maps, on real pushes: how many stay within the threshold.

The held-out pushes of a fit are halved. One half makes a map of every plate and surface; the pushes
of the other half in its trusted cells are counted. Confidences from which cells are trusted are
those of the claim ("stated"), raised by the map itself ("raised"), or by the maps of the other
plates alone ("outer").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fixel.domain.cells import cells_of
from fixel.domain.claim import Claim
from fixel.domain.domain import DomainMap, domain_map
from fixel.domain.evidence import HeldOutErrors
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray

PLACES: Final = ("tip_x", "tip_y", "along_x", "along_y")
CONTACT, PUSH = "contact_angle_rad", "push_angle_rad"
# Widths of the cells by axis [rad].
MAPS: Final = (
    {CONTACT: np.pi / 8.0},
    {CONTACT: np.pi / 16.0},
    {CONTACT: np.pi / 6.0, PUSH: np.pi / 9.0},
)
THRESHOLDS: Final = (3, 4, 5, 7)  # [mm], angles at 35 mm/rad
RULES: Final = ("stated", "raised", "outer")


class Half:
    """Half of the held-out pushes.

    Parameters
    ----------
    features : (n, 4) float64
        Columns `PLACES`.
    error : (n,) float64
        Errors, angles at 35 mm/rad [m].
    group : (n,) sequence of str
        Surface and plate.
    """

    def __init__(self, features: FloatArray, error: FloatArray, group: Sequence[str]) -> None:
        tip, way = np.arctan2(features[:, 1], features[:, 0]), features[:, 2:]
        push = np.arctan2(way[:, 1], way[:, 0]) - tip - np.pi
        self.error_mm = 1e3 * error
        number = range(len(error))
        self.evidence = HeldOutErrors(
            keys=tuple(map(str, number)),
            ids=tuple(number),
            coordinates={
                CONTACT: tuple(tip.tolist()),
                PUSH: tuple(np.angle(np.exp(1j * push)).tolist()),
            },
            error_mm2=self.error_mm**2,
            group=tuple(group),
        )


def map_rows(halves: Sequence[tuple[Half, Half]]) -> list[Row]:
    """Count pushes in trusted cells; each pair has the half for the map, and the counted one."""
    within: dict[tuple[int, int, str], list[bool]] = {}
    for number, steps in enumerate(MAPS):
        for known, new in halves:
            cells = cells_of(known.evidence, list(steps), {}, steps)
            made = domain_map(known.evidence, cells)
            place = cells.find(new.evidence)
            group = np.array([made.groups.index(name) for name in new.evidence.group])
            for tau in THRESHOLDS:
                for rule in RULES:
                    trusted = _trusted(made, float(tau), rule)[group, place] & (place >= 0)
                    own = within.setdefault((number, tau, rule), [])
                    own += (new.error_mm <= tau)[trusted].tolist()
    return [
        {
            "axes": ", ".join(MAPS[number]),
            "width_deg": float(np.degrees(MAPS[number][CONTACT])),
            "tau_mm": tau,
            "confidence": rule,
            "trusted": len(own),
            "within": float(np.mean(own)) if own else None,
        }
        for (number, tau, rule), own in within.items()
    ]


def _trusted(made: DomainMap, tau: float, rule: str) -> BoolArray:
    """Return a mask (n_group, n_cell) of the trusted cells."""
    claim = Claim(threshold=tau)
    least = np.full(len(made.groups), claim.confidence)
    if rule == "raised":
        least[:] = made.required_confidence(claim)
    if rule == "outer":
        plate = [name.split()[1] for name in made.groups]
        for k, own in enumerate(plate):
            others = [name for name, p in zip(made.groups, plate, strict=True) if p != own]
            least[k] = made.required_confidence(claim, others)
    sure = made.confidence(claim) >= least[:, None]
    return np.asarray(sure & (made.statistic(claim.level) <= tau))
