"""Coordinates of a push that the axes of a map can use: conditions, and geometry of the push."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from fixel.calibration.contacts import CONTACT_ANGLE
from fixel.calibration.target import Target
from fixel.domain.evidence import Value
from fixel.errors import InvalidInput
from fixel.model import wrapped
from fixel.simulation.pack import pusher_path

PUSH: Final = "push_angle_rad"
TRAVEL: Final = "travel_m"
_HIDDEN: Final = ("experiment", "repetition", "step")
_TRUTH: Final = "truth_"


def coordinates_of(target: Target) -> dict[str, Value]:
    """Return all coordinates that an axis can use.

    In addition to the conditions: the bearing of the pusher at the start from the centre of mass,
    in the body's frame [rad]; its direction of travel relative to the line to the centre of mass
    [rad]; its distance of travel [m]. Truths that no real laboratory could know are left out.
    """
    found: dict[str, Value] = {
        name: value
        for name, value in target.conditions.items()
        if name not in _HIDDEN and not name.startswith(_TRUTH)
    }
    for name, number in _geometry(target).items():
        found.setdefault(name, number)
    return found


def _geometry(target: Target) -> dict[str, float]:
    scene = target.case.scene
    if not scene.pushers:
        return {}
    path = pusher_path(scene.pushers[0], float(target.case.times[-1]))
    way = path[-1, 1:3] - path[0, 1:3]
    body = scene.bodies[0]
    c, s = math.cos(float(body.pose[2])), math.sin(float(body.pose[2]))
    turn = np.array([[c, -s], [s, c]])
    arm = path[0, 1:3] - (body.pose[:2] + turn @ body.com)
    found = {TRAVEL: float(np.hypot(*way))}
    if np.hypot(*arm) > 0.0:
        bearing = math.atan2(float(arm[1]), float(arm[0])) - float(body.pose[2])
        found[CONTACT_ANGLE] = _short(bearing)
        if found[TRAVEL] > 0.0:
            heading = math.atan2(float(way[1]), float(way[0]))
            found[PUSH] = _short(heading - math.atan2(-float(arm[1]), -float(arm[0])))
    return found


def _short(angle: float) -> float:
    return float(wrapped(np.array([angle]))[0])


def refuse_missing(
    known: Mapping[str, Any], given: Mapping[str, Value], examples: Mapping[str, Value]
) -> None:
    """Raise if a push lacks a condition; the error shows the call with values for all of them.

    Parameters
    ----------
    known : mapping
        Coordinates of the push.
    given : mapping
        Conditions of the call.
    examples : mapping of str to value
        Every needed condition, with a value that occurs in the experiments.
    """
    missing = {name: value for name, value in examples.items() if name not in known}
    if missing:
        pairs = (
            f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value!r}"
            for name, value in ({**given, **missing}).items()
        )
        raise InvalidInput(
            "scene",
            found=f"a push without {' and '.join(missing)}",
            expected="every condition that the result distinguishes",
            hint=f"give its own value, as in .at(scene, {', '.join(pairs)})",
        )


def label_of(conditions: Mapping[str, Any], names: Sequence[str]) -> str:
    """Label of the experiments that share the values of some conditions."""
    missing = [name for name in names if name not in conditions]
    if missing:
        raise InvalidInput(
            "conditions",
            found=f"{conditions.get('experiment', 'an experiment')} without {missing[0]}",
            expected="a condition that all experiments have",
            hint="see which there are: fixel show",
        )
    return " ".join(
        f"{conditions[n]:g}" if isinstance(conditions[n], float) else str(conditions[n])
        for n in names
    )
