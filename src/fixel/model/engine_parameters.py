"""Description of a parameter, and parameters of other engines, which calibrations may change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from fixel.errors import check_name


class ParameterInfo(NamedTuple):
    """Unit, range and meaning of a parameter."""

    unit: str
    meaning: str
    lowest: float = 0.0  # smallest value
    above: bool = False  # whether `lowest` itself is excluded
    # Property of the real object that an estimate of an effective parameter represents; empty where
    # the parameter itself is such a property.
    stands_for: str = ""
    # Contact of the free body that the parameter acts on: "pusher" or "fixel"; empty for others.
    contact: str = ""
    # Of another engine: lower bound, start and upper bound of a usual search.
    usual: tuple[float, float, float] | None = None


Usual = tuple[float, float, float]


def _table(rows: Mapping[str, tuple[str, str, Usual]]) -> Mapping[str, ParameterInfo]:
    """Return parameters from unit, meaning, and lower bound, start and upper bound of a search.

    A parameter is above zero where the search stays above it.
    """
    return MappingProxyType(
        {
            name: ParameterInfo(unit, meaning, above=usual[0] > 0.0, usual=usual)
            for name, (unit, meaning, usual) in rows.items()
        }
    )


_FACTOR = "factor of the moment of inertia, a remedy for inexact contacts"
_INERTIA: Final = {"inertia_factor": ("-", _FACTOR, (1.0, 1.0, 30.0))}
BOX2D: Final = _table(_INERTIA)
CHIPMUNK: Final = _table(
    _INERTIA | {"slop": ("m", "overlap that the engine allows", (1e-7, 1e-7, 1e-4))}
)
MUJOCO: Final = _table(
    {
        "timeconst": ("s", "time constant of contacts, solref[0]", (0.004, 0.02, 0.1)),
        "dmin": ("-", "impedance of contacts at zero overlap, solimp[0]", (0.5, 0.9, 0.99)),
        "dmax": ("-", "largest impedance of contacts, solimp[1]", (0.9, 0.95, 0.9999)),
        "width": ("m", "overlap at the largest impedance, solimp[2]", (1e-4, 1e-3, 1e-2)),
        "impratio": ("-", "stiffness of friction over that of contacts", (1.0, 1.0, 100.0)),
        "torsion": ("m", "torsional friction of every support point", (0.0, 0.0, 0.02)),
    }
)
DRAKE: Final = _table(
    {
        "stiffness": ("N/m", "stiffness of a contact point", (1e4, 1e6, 1e7)),
        "dissipation": ("s/m", "dissipation of Hunt and Crossley", (0.0, 50.0, 100.0)),
        "relaxation": ("s", "relaxation time of contacts, of SAP only", (1e-3, 0.1, 1.0)),
        "stiction": ("m/s", "tolerance of stiction, of TAMSI only", (1e-6, 1e-3, 1e-2)),
    }
)
ENGINE_PARAMETERS: Final[Mapping[str, Mapping[str, ParameterInfo]]] = MappingProxyType(
    {"pymunk": CHIPMUNK, "box2d": BOX2D, "mujoco": MUJOCO, "drake": DRAKE}
)


def engine_parameter(name: str) -> ParameterInfo:
    """Return unit, range and meaning of ``"engine.parameter"``, also of an unknown engine."""
    engine, _, own = name.partition(".")
    known = ENGINE_PARAMETERS.get(engine)
    if known is None:
        return ParameterInfo("-", f"parameter {own} of the engine {engine}", -math.inf)
    check_name(f"parameters of {engine}", own, known)
    return known[own]
