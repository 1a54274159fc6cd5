"""Parameters of other engines, which a calibration may change with those of the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from fixel.errors import unknown_name
from fixel.model.parameter_info import ParameterInfo

_INERTIA = ParameterInfo(
    "-",
    "factor of the moment of inertia, a remedy for inexact contacts",
    above=True,
    usual=(1.0, 1.0, 30.0),
)

CHIPMUNK: Final[Mapping[str, ParameterInfo]] = MappingProxyType(
    {
        "inertia_factor": _INERTIA,
        "slop": ParameterInfo(
            "m",
            "overlap that the engine allows",
            above=True,
            usual=(1e-7, 1e-7, 1e-4),
        ),
    }
)
BOX2D: Final[Mapping[str, ParameterInfo]] = MappingProxyType({"inertia_factor": _INERTIA})
MUJOCO: Final[Mapping[str, ParameterInfo]] = MappingProxyType(
    {
        "timeconst": ParameterInfo(
            "s",
            "time constant of contacts, solref[0]",
            above=True,
            usual=(0.004, 0.02, 0.1),
        ),
        "dmin": ParameterInfo(
            "-",
            "impedance of contacts at zero overlap, solimp[0]",
            above=True,
            usual=(0.5, 0.9, 0.99),
        ),
        "dmax": ParameterInfo(
            "-",
            "largest impedance of contacts, solimp[1]",
            above=True,
            usual=(0.9, 0.95, 0.9999),
        ),
        "width": ParameterInfo(
            "m",
            "overlap at the largest impedance, solimp[2]",
            above=True,
            usual=(1e-4, 1e-3, 1e-2),
        ),
        "impratio": ParameterInfo(
            "-",
            "stiffness of friction over that of contacts",
            above=True,
            usual=(1.0, 1.0, 100.0),
        ),
        "torsion": ParameterInfo(
            "m",
            "torsional friction of every support point",
            usual=(0.0, 0.0, 0.02),
        ),
    }
)
DRAKE: Final[Mapping[str, ParameterInfo]] = MappingProxyType(
    {
        "stiffness": ParameterInfo(
            "N/m",
            "stiffness of a contact point",
            above=True,
            usual=(1e4, 1e6, 1e7),
        ),
        "dissipation": ParameterInfo(
            "s/m",
            "dissipation of Hunt and Crossley",
            usual=(0.0, 50.0, 100.0),
        ),
        "relaxation": ParameterInfo(
            "s",
            "relaxation time of contacts, of SAP only",
            above=True,
            usual=(1e-3, 0.1, 1.0),
        ),
        "stiction": ParameterInfo(
            "m/s",
            "tolerance of stiction, of TAMSI only",
            above=True,
            usual=(1e-6, 1e-3, 1e-2),
        ),
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
    if own not in known:
        raise unknown_name(f"parameters of {engine}", own, known)
    return known[own]
