"""The named values a calibration may change."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple, final

from fixel.errors import InvalidInput
from fixel.model.fields import non_negative, positive
from fixel.model.scene import Scene
from fixel.model.support import Ellipsoid, Tripod


class ParameterInfo(NamedTuple):
    """Unit and meaning of a parameter."""

    unit: str
    meaning: str


KNOWN_PARAMETERS: Final[Mapping[str, ParameterInfo]] = MappingProxyType(
    {
        "mu_support": ParameterInfo("-", "friction of every support against the plane"),
        "mu_fixel": ParameterInfo("-", "friction of every free body against every fixel"),
        "mu_pusher": ParameterInfo("-", "friction of every free body against every pusher"),
        "tripod_radius": ParameterInfo("m", "distance of tripod points from the centre of mass"),
    }
)


@final
class Parameters(Mapping[str, float]):
    """An immutable mapping from names of parameters to values.

    What is left out stays as in the scene.

    Parameters
    ----------
    values : mapping of str to float
        Names out of `KNOWN_PARAMETERS`, values in the units given there.
    **named : float
        The same, as keywords; they count more.

    Examples
    --------
    >>> Parameters(mu_support=0.25) | {"mu_fixel": 0.2}
    Parameters(mu_support=0.25, mu_fixel=0.2)
    """

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, float] | None = None, /, **named: float) -> None:
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

    def check(self, scene: Scene) -> None:
        """Refuse values that would change nothing, or nothing known, in a scene."""
        if "mu_support" in self:
            for body in scene.bodies:
                if isinstance(body.support, Ellipsoid):
                    raise InvalidInput(
                        "mu_support",
                        found=f"an ellipsoidal limit surface under body {body.name!r}",
                        expected="supports with a coefficient of friction",
                        hint="change the force and torque of the ellipsoid instead",
                    )
        if "tripod_radius" in self and not any(isinstance(b.support, Tripod) for b in scene.bodies):
            raise InvalidInput("tripod_radius", found="no tripod", expected="a body on a tripod")


def _checked(name: str, value: float) -> float:
    if name not in KNOWN_PARAMETERS:
        close = difflib.get_close_matches(str(name), KNOWN_PARAMETERS, n=1)
        raise InvalidInput(
            "parameters",
            found=repr(name),
            expected="one of " + ", ".join(KNOWN_PARAMETERS),
            hint=f"did you mean {close[0]!r}?" if close else None,
        )
    if name == "tripod_radius":
        return positive(value, name, "m")
    return non_negative(value, name)
