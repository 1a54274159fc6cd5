"""Appearance of a film: light, lens, sensor and disturbances."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Final, final

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model.fields import Value, check_fields, field_types, fraction, non_negative, settle
from fixel.model.probability import stream
from fixel.typing import FloatArray

LIGHTINGS: Final = ("above", "through")

Pixels = Annotated[float, Value(non_negative, "px")]
Seconds = Annotated[float, Value(non_negative, "s")]
Levels = Annotated[float, Value(non_negative, "grey levels")]
Share = Annotated[float, Value(fraction)]
Ratio = Annotated[float, Value(non_negative)]

# Pixels smaller than this belong to a microscope, larger ones to a camera over the testbed.
MICROSCOPE: Final = 5e-5  # [m/px]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEffects:
    """Properties of light, lens and sensor, and disturbances of a film.

    The sensor is linear: grey levels are proportional to light, so that the true place of an edge
    has the mean level of its two sides.
    """

    # `"above"`: a testbed under a lamp. `"through"`: a microscope's bright field.
    lighting: str = "above"
    exposure: Seconds = 0.0  # exposure time of a frame, whose time stamp is its middle [s]
    blur: Pixels = 0.0  # standard deviation of the lens's blur [px]
    vignetting: Share = 0.0  # share of the light that is missing in the corners of the picture [-]
    shadows: Share = 0.5  # share of the light that is missing in a full shadow [-]
    read_noise: Levels = 0.0  # standard deviation of the noise in the dark [grey levels of 255]
    # Standard deviation of the photon noise at full white [grey levels]; it grows with the root of
    # the light.
    shot_noise: Levels = 0.0
    drift: Ratio = 0.0  # standard deviation of slow changes of the brightness, as a share [-]
    # Share of the light that is missing for a while in the middle of the film [-].
    light_change: Share = 0.0
    colour_change: Share = 0.0  # relative increase of red and decrease of blue at the same time [-]
    occlusion: Seconds = 0.0  # duration for which a hand lies over the object [s]
    occluded: Share = 0.5  # share of the object's upper face that the hand covers [-]
    dropped: Share = 0.0  # probability that a frame is lost [-]
    jitter: Ratio = 0.0  # standard deviation of frame times, as a share of the interval [-]
    # Width and length of the rest of the lead on a short side of a part under the microscope [m].
    tab: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_name("looks.lighting", self.lighting, LIGHTINGS)
        check_fields(self, "looks")
        width, length = (non_negative(side, "looks.tab", "m") for side in self.tab)
        settle(self, tab=(width, length))


_NUMBERS: Final = tuple(name for name, own in field_types(CameraEffects).items() if own.value)

_THESIS: Final = CameraEffects(
    exposure=1.0 / 100.0,
    blur=0.6,
    vignetting=0.18,
    read_noise=1.2,
    shot_noise=2.5,
    drift=0.01,
    dropped=0.003,
    jitter=0.01,
)
_MICROSCOPE: Final = CameraEffects(
    lighting="through",
    exposure=1.0 / 60.0,
    blur=1.1,
    vignetting=0.15,
    read_noise=1.5,
    shot_noise=2.0,
    drift=0.005,
    tab=(173e-6, 53e-6),
)
PRESETS: Final[dict[str, CameraEffects]] = {
    "clean": CameraEffects(),
    "thesis": _THESIS,
    "hard": replace(
        _THESIS,
        exposure=1.0 / 33.0,
        blur=1.1,
        read_noise=2.0,
        shot_noise=4.0,
        light_change=0.3,
        colour_change=0.06,
        occlusion=2.0,
    ),
    "microscope-clean": CameraEffects(lighting="through"),
    "microscope": _MICROSCOPE,
}


def looks_named(name: str) -> CameraEffects:
    """Return the preset with a name; raise `InvalidInput` if there is none."""
    check_name("looks", name, PRESETS)
    return PRESETS[name]


def changed(looks: CameraEffects, changes: Iterable[str]) -> CameraEffects:
    """Return looks with some numbers changed, each given as `NAME=VALUE`."""
    for text in changes:
        name, equals, value = text.partition("=")
        if name not in _NUMBERS or not equals:
            expected = "NAME=VALUE, where NAME is one of " + ", ".join(_NUMBERS)
            raise InvalidInput("changes", found=repr(text), expected=expected)
        try:
            looks = replace(looks, **{name: float(value)})  # type: ignore[arg-type]
        except InvalidInput as problem:
            raise problem.at(f"changes {name}") from None
        except ValueError:
            raise InvalidInput(f"changes {name}", found=repr(value), expected="a number") from None
    return looks


def frame_times(duration: float, rate: float, looks: CameraEffects, seed: int) -> FloatArray:
    """Draw the times (n,) of frames from 0 on [s], with jitter and without lost frames."""
    count = int(duration * rate + 1e-6) + 1
    random = stream(seed, "film", "clock")
    wobble = random.standard_normal(count)
    kept = random.random(count) >= looks.dropped
    kept[[0, -1]] = True
    # Limited, so that the order of frames is preserved.
    late = np.clip(looks.jitter * wobble, -0.3, 0.3)
    late[0] = 0.0
    return np.asarray(((np.arange(count) + late) / rate)[kept])


def light(looks: CameraEffects, times: FloatArray, seed: int) -> FloatArray:
    """Factors (n, 3) of blue, green and red at times (n,) of a film [-].

    Brightness varies slowly. During three tenths of the film, in its middle, `light_change` of the
    light is missing, as when a cloud passes, and the rest is warmer by `colour_change`.
    """
    random = stream(seed, "film", "light")
    span = max(float(times[-1] - times[0]), 1e-9)
    phase, pace = random.uniform(0.0, 2.0 * np.pi, 3), random.uniform(0.1, 0.7, 3)
    wander = np.sin(2.0 * np.pi * np.outer(times, pace) + phase).sum(axis=1) * np.sqrt(2.0 / 3.0)
    begins = random.uniform(0.3, 0.4) * span + times[0]
    edge = min(0.4, 0.1 * span)  # [s] of transition
    cloud = _smooth((times - begins) / edge) - _smooth((times - begins - 0.3 * span) / edge)
    bright = (1.0 + looks.drift * wander) * (1.0 - looks.light_change * cloud)
    warm = looks.colour_change * cloud[:, None] * np.array([-1.0, 0.0, 1.0])
    return np.asarray(bright[:, None] * (1.0 + warm))


def _smooth(x: FloatArray) -> FloatArray:
    """Smooth step from 0 to 1 between 0 and 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))
