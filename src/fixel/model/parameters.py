"""Named parameters that a calibration may change, those of other engines included."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple, final

from fixel.errors import InvalidInput, check_name, unknown_name
from fixel.model.fields import finite, instance
from fixel.units import cm, deg, g, mm, mrad, um

_LOADS = "the distribution of the load under the body"
_CENTRE = "the centre of pressure and the unevenness of the plane"


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


def _signed(unit: str, meaning: str, stands_for: str = "") -> ParameterInfo:
    """Parameter of any sign."""
    return ParameterInfo(unit, meaning, -math.inf, stands_for=stands_for)


def _load(meaning: str) -> ParameterInfo:
    """Parameter of any sign that changes how the load is distributed."""
    return _signed("-", meaning, _LOADS)


KNOWN_PARAMETERS: Final[Mapping[str, ParameterInfo]] = MappingProxyType(
    {
        "mass": ParameterInfo("kg", "mass of the free body, its inertia in proportion", above=True),
        "mu_support": ParameterInfo(
            "-",
            "friction of every support against the plane",
            stands_for="the motion while the drive stalls or the body coasts",
        ),
        "mu_fixel": ParameterInfo(
            "-", "friction of every free body against every fixel", contact="fixel"
        ),
        "mu_pusher": ParameterInfo(
            "-", "friction of every free body against every pusher", contact="pusher"
        ),
        "tripod_radius": ParameterInfo(
            "m", "distance of tripod points from the centre of mass", above=True, stands_for=_LOADS
        ),
        **{
            f"support_{k}_{axis}": _signed(
                "m", f"{axis} of the free support point {k}, in the frame of the shape", _LOADS
            )
            for k in (1, 2, 3)
            for axis in "xy"
        },
        **{
            f"friction_centre_{axis}": _signed(
                "m", f"shift of all supports along the body's {axis}", _CENTRE
            )
            for axis in "xy"
        },
        "pressure_spread": _load(
            "pressure under the whole body instead of the support of the scene: uniform at 0, "
            "larger towards the rim above 0, towards the middle below 0"
        ),
        "pressure_rim": _load(
            "balanced loads on a net of points instead of the support of the scene: equal at 0, "
            "larger towards the rim above 0"
        ),
        "pressure_corner": _load("the same, larger at corners above 0"),
        "pressure_xy": _load(
            "the same, larger far along the body's x and smaller far along its y above 0"
        ),
        "pressure_diagonal": _load("the same, between the diagonals of the body's x and y"),
        "pressure_tilt_x": _load(
            "the same, larger towards the body's x than the balance at the centre of mass needs"
        ),
        "pressure_tilt_y": _load("the same, towards the body's y"),
        "ellipsoid_force": ParameterInfo(
            "N", "largest friction force of an ellipsoid", above=True, stands_for=_LOADS
        ),
        "ellipsoid_torque": ParameterInfo(
            "N m", "largest friction torque of an ellipsoid", above=True, stands_for=_LOADS
        ),
        "anisotropy_xy": ParameterInfo(
            "-", "friction of the plane along world x above its mean, and along y below it", -0.9
        ),
        "anisotropy_diagonal": ParameterInfo(
            "-",
            "friction of the plane along one diagonal of world x and y above its mean, and "
            "along the other below it",
            -0.9,
        ),
        "table_bend": _load("extra load far from the centroid, on a table that is not flat"),
        "table_bend_xy": _load(
            "extra load far along world x and reduced load far along y, on a table that is not flat"
        ),
        "table_bend_diagonal": _load(
            "extra load far along the diagonals of world x and y, on a table that is not flat"
        ),
        "table_slope_x": _load("extra load towards larger world x, on a table that is not flat"),
        "table_slope_y": _load("the same along world y"),
        "registration_x": _signed(
            "m", "shift along world x from the recorded to the true position of the pusher"
        ),
        "registration_y": _signed("m", "the same along world y"),
        "registration_theta": _signed(
            "rad", "rotation of the recorded path of the pusher about the origin of the world"
        ),
        "start_x": _signed("m", "error of the measured start pose along world x"),
        "start_y": _signed("m", "the same along world y"),
        "start_theta": _signed("rad", "error of the measured start angle"),
        "outline_x": _signed("m", "x of the outline in the frame whose pose was measured"),
        "outline_y": _signed("m", "y of the outline in that frame"),
        "outline_theta": _signed("rad", "angle of the outline in that frame"),
        "contact_offset": _signed("m", "increase of the radius of a round pusher"),
    }
)

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


_LOAD = re.compile(r"load_[1-9]\d{0,4}")
# Parameters of supports that replace the support of the scene, and of those that they replace.
_REPLACING = re.compile(r"pressure_(spread|rim|corner|xy|diagonal|tilt_[xy])")
_REPLACED = re.compile(r"tripod_radius|support_[123]_[xy]|ellipsoid_(force|torque)|load_\d+")


_UNITS: Final = {"_mm": mm, "_cm": cm, "_um": um, "_deg": deg, "_mrad": mrad, "_g": g}


def is_parameter(name: str) -> bool:
    """Return whether a name is that of a parameter, with `load_1`, ... and those of engines."""
    return name in KNOWN_PARAMETERS or "." in name or _LOAD.fullmatch(name) is not None


def in_si(written: str) -> tuple[str, float]:
    """Return the name of a parameter and the factor from the unit in its written name to SI."""
    for ending, factor in _UNITS.items():
        name = written.removesuffix(ending)
        if name != written and "." not in name and is_parameter(name):
            return name, factor
    return written, 1.0


def info_of(name: str, where: str = "parameters") -> ParameterInfo:
    """Return unit, range and meaning of a parameter; raise for unknown names."""
    if name in KNOWN_PARAMETERS:
        return KNOWN_PARAMETERS[name]
    if _LOAD.fullmatch(str(name)):
        return ParameterInfo(
            "-", f"load on support point {name[5:]}, relative to the others", stands_for=_LOADS
        )
    if "." in str(name):
        return engine_parameter(name)
    if "[" in str(name):
        found = f"{name.partition('[')[0]} for some conditions only"
        hint = "select with fit.values_for(...); search them with fixel calibrate --space FILE"
        raise InvalidInput(where, found=found, expected="one value for each parameter", hint=hint)
    raise unknown_name(where, name, KNOWN_PARAMETERS, more=", load_1, load_2, ...")


def check_supports(names: Iterable[str]) -> None:
    """Raise for a pressure under the body together with parameters of a support it replaces."""
    known = tuple(names)
    replacing = [name for name in known if _REPLACING.fullmatch(name)]
    replaced = [name for name in known if _REPLACED.fullmatch(name)]
    if "pressure_spread" in replacing:
        replacing.remove("pressure_spread")
        replaced, replacing = replaced + replacing, ["pressure_spread"]
    if replacing and replaced:
        raise InvalidInput(
            f"parameters.{replacing[0]}",
            found=f"{', '.join(replaced)} in addition to it",
            expected="one of them: it replaces the support that they describe",
            hint=f"remove {replacing[0]}, or " + ", ".join(replaced),
        )


@final
class Parameters(Mapping[str, float]):
    """Immutable mapping from names of parameters to values.

    Missing parameters have the value of the scene.

    Parameters
    ----------
    values : mapping of str to float
        Names out of `KNOWN_PARAMETERS`, values in the units given there.
    **named : float
        The same as keywords, which override `values`.

    Examples
    --------
    >>> Parameters(mu_support=0.25) | {"mu_fixel": 0.2}
    Parameters(mu_support=0.25, mu_fixel=0.2)
    """

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, float] | None = None, /, **named: float) -> None:
        instance({} if values is None else values, Mapping, "parameters", "values by name")
        given = {**(values or {}), **named}
        self._values = MappingProxyType({name: _checked(name, x) for name, x in given.items()})

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __or__(self, other: Mapping[str, float]) -> Parameters:
        return Parameters({**self, **other})

    def __hash__(self) -> int:
        return hash(frozenset(self._values.items()))

    def __repr__(self) -> str:
        return f"Parameters({', '.join(f'{name}={x!r}' for name, x in self.items())})"

    def __reduce__(self) -> tuple[type[Parameters], tuple[dict[str, float]]]:
        return Parameters, (dict(self),)


def _checked(name: str, value: float) -> float:
    info = info_of(name)
    number = finite(value, name, info.unit if info.unit != "-" else "")
    if number < info.lowest or (info.above and number == info.lowest):
        relation = "greater than" if info.above else "of at least"
        unit = f" [{info.unit}]" if info.unit != "-" else ""
        found, expected = number, f"a number {relation} {info.lowest:g}{unit}"
        raise InvalidInput(name, found=found, expected=expected)
    return number
