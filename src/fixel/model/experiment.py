"""Experiments: scene, measurements, and flags on the quality of the data."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import degrees
from numbers import Real
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike

from fixel.errors import InvalidInput, counted
from fixel.model import fields
from fixel.model.fields import Comparable, instance, name_of, settle
from fixel.model.scene import Scene
from fixel.model.trajectory import Trajectory
from fixel.registry import offered
from fixel.results import Result, Summary
from fixel.table import Column, Table
from fixel.typing import FloatArray
from fixel.units import length_unit

# Units of a channel's columns. The name of a column ends with its unit: `fx_n`.
UNITS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "s": "s",
        "m": "m",
        "rad": "rad",
        "n": "N",
        "nm": "N m",
        "m_s": "m/s",
        "rad_s": "rad/s",
        "bool": "-",
        "count": "-",
        "ratio": "-",
    }
)


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel(Comparable):
    """Measured quantities against their own times.

    Parameters
    ----------
    name : str
        Name of the sensor: `"force"`, `"tactile"`.
    time : (n,) array_like
        Times that do not decrease, on the clock of the experiment [s].
    columns : tuple of str
        Names of the values; each ends with its unit, out of `UNITS`: `"fx_n"`, `"fixel_1_bool"`.
    values : (n, n_column) array_like
        Measured values; NaN where there was no reading.
    """

    name: str
    time: FloatArray
    columns: tuple[str, ...]
    values: FloatArray

    def __post_init__(self) -> None:
        where = f"channel {name_of(self.name, 'channel.name')!r}"
        columns = fields.texts(self.columns, "channel.columns")
        time = fields.frozen(fields.floats(self.time, f"{where}.time", "instants [s]"))
        values = fields.readings(self.values, where)
        for column in columns:
            unit_of(column)
        if time.ndim != 1 or values.shape != (len(time), len(columns)):
            found = f"values of shape {values.shape} for times of shape {time.shape}"
            expected = f"a row of {len(columns)} values for each time"
            raise InvalidInput(where, found=found, expected=expected)
        if not np.isfinite(time).all() or (np.diff(time) < 0.0).any():
            raise InvalidInput(f"{where}.time", found="decreasing times", expected="instants [s]")
        if np.isinf(values).any():
            raise InvalidInput(where, found="infinite values", expected="numbers, or NaN for none")
        settle(self, columns=columns, time=time, values=values)

    @classmethod
    def of_fixels(cls, time: ArrayLike, values: ArrayLike) -> Channel:
        """Return the readings (n, n_fixel) of contact sensors: 1 with contact, 0 without."""
        columns = tuple(f"fixel_{k + 1}_bool" for k in range(np.shape(values)[-1]))
        time, values = np.asanyarray(time), np.asanyarray(values)
        return cls(name="tactile", time=time, columns=columns, values=values)


def unit_of(column: str) -> str:
    """Return the unit at the end of a column's name; raise if there is none."""
    for ending in sorted(UNITS, key=len, reverse=True):
        if re.fullmatch(rf"\w+_{ending}", column):
            return UNITS[ending]
    expected = "a name with its unit as suffix, one of _" + ", _".join(UNITS)
    raise InvalidInput("channel.columns", found=repr(column), expected=expected)


@final
@dataclass(frozen=True, slots=True, order=True)
class Flag:
    """Remark on the data of an experiment that matters for their use.

    Parameters
    ----------
    name : str
        Short name, the same for all experiments concerned: `"misregistered"`.
    detail : str
        Finding in this experiment: `"starts 4.2 mm inside the pusher"`.
    fault : bool
        Whether listings leave the experiment out by default; else it is a remark.
    """

    name: str
    detail: str = ""
    fault: bool = True

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9-]*", name_of(self.name, "flag.name")):
            raise InvalidInput("flag.name", found=repr(self.name), expected="text of a-z, 0-9, -")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Origin of a record, sufficient to reproduce it.

    Parameters
    ----------
    version : str
        Version of fixel.
    command : str
        Command or function call.
    source : str
        Name of the file it was read from; empty for none.
    sha256 : str
        Checksum of that file.
    seed : int, optional
        Seed of the random numbers.
    created : str
        Time of creation, as ISO 8601 in UTC; empty until it is stored.
    """

    version: str
    command: str = ""
    source: str = ""
    sha256: str = ""
    seed: int | None = None
    created: str = ""


def conditions_of(values: Mapping[str, Any], where: str) -> Mapping[str, str | float]:
    """Return conditions by name, checked to be texts or numbers; those of NumPy become Python's."""
    instance(values, Mapping, where, "values by name")
    for name, value in values.items():
        place = f"{where} {name_of(name, where)!r}"
        instance(value, str | Real, place, "a text or a number")
        if not isinstance(value, str | bool):
            fields.finite(value, place)
    plain = {k: v.item() if isinstance(v, np.str_ | np.integer) else v for k, v in values.items()}
    exact = {k: v if isinstance(v, str | int) else float(v) for k, v in plain.items()}
    return MappingProxyType(dict(sorted(exact.items())))


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Experiment(Comparable, Result):
    """Run on a plate, real or simulated.

    Parameters
    ----------
    dataset, name : str
        Together the name of the experiment: `"rpi-2dgad"` and `"141"`.
    real : bool
        Whether it was recorded by a camera; always False for simulated data.
    simulated_by : str
        Program that simulated it; empty for real experiments.
    provenance : Provenance
    object_name : str
        Name of the body of `scene` whose motion was measured.
    trajectory : Trajectory
        Measured poses of the object in the world.
    pusher : Trajectory, optional
        Measured poses of the pusher, on the same clock.
    scene : Scene, optional
        Bodies on the plate at the first measured pose, with nominal friction; None if it is not
        fully known.
    height, pusher_height, fixel_height : float, optional
        Heights above the plane [m], which tracking by a camera needs.
    channels : tuple of Channel
        Tactile signals, forces, raw readings.
    contact_mode : str
        Contacts at the end, one digit per fixel: `"010"` where the second of three touches the
        object; empty where unknown.
    effective : (float, float), optional
        First and last time of useful data [s].
    conditions : mapping of str to str or float
        Other recorded conditions: `{"surface": "plywood", "speed_m_s": 0.02}`.
    flags : tuple of Flag
        Flags, sorted.
    video : str
        Checksum of a file in the media folder; empty for none.

    Examples
    --------
    >>> import fixel
    >>> push = fixel.datasets.example()[0]
    >>> push
    Experiment example/00, simulated by fixel: 61 frames, 3.00 s
      part   x [mm]  y [mm]  angle [deg]
      start  210.26  -47.14      -126.63
      end    202.78  -90.20       -94.97
      contact_offset_m=-0.022 push_angle_rad=0 surface=abs
    >>> push.simulate().status
    'converged'
    """

    dataset: str
    name: str
    real: bool
    provenance: Provenance
    trajectory: Trajectory
    object_name: str = "object"
    simulated_by: str = ""
    pusher: Trajectory | None = None
    scene: Scene | None = None
    height: float | None = None
    pusher_height: float | None = None
    fixel_height: float | None = None
    channels: tuple[Channel, ...] = ()
    contact_mode: str = ""
    effective: tuple[float, float] | None = None
    conditions: Mapping[str, str | float] = field(default_factory=dict)
    flags: tuple[Flag, ...] = ()
    video: str = ""

    __repr__ = Result.__repr__

    def __post_init__(self) -> None:
        name_of(self.dataset, "experiment.dataset")
        where = f"experiment {self.dataset}/{name_of(self.name, 'experiment.name')}"
        for part, (kind, expected) in _KINDS.items():
            instance(getattr(self, part), kind, f"{where}.{part}", expected)
        if self.real == bool(self.simulated_by):
            expected = "empty for a real experiment, or the name of the simulator"
            found = repr(self.simulated_by)
            raise InvalidInput(f"{where}.simulated_by", found=found, expected=expected)
        for label in ("height", "pusher_height", "fixel_height"):
            settle(self, **{label: fields.optional_positive(getattr(self, label), label, "m")})
        if not re.fullmatch(r"[01]*", self.contact_mode):
            found, expected = repr(self.contact_mode), "a digit 0 or 1 for each fixel"
            raise InvalidInput(f"{where}.contact_mode", found=found, expected=expected)
        if self.scene is not None:
            self._check_scene(where, self.scene)
        if self.effective is not None:
            place, labels = f"{where}.effective", "first time [s], last time [s]"
            first, last = fields.vector(self.effective, place, labels).tolist()
            if not first <= last:
                raise InvalidInput(place, found=(first, last), expected="in increasing order")
            settle(self, effective=(first, last))
        settle(
            self,
            real=bool(self.real),
            channels=_several(self.channels, Channel, f"{where}.channels"),
            conditions=conditions_of(self.conditions, f"{where}.conditions"),
            flags=tuple(sorted(_several(self.flags, Flag, f"{where}.flags"))),
        )

    def _check_scene(self, where: str, scene: Scene) -> None:
        if self.object_name not in [body.name for body in scene.bodies]:
            found = repr(self.object_name)
            expected = "a body of the scene: " + ", ".join(body.name for body in scene.bodies)
            raise InvalidInput(f"{where}.object_name", found=found, expected=expected)
        if self.contact_mode and len(self.contact_mode) != len(scene.fixels):
            found = f"{len(self.contact_mode)} digits"
            expected = f"{len(scene.fixels)}, one per fixel"
            raise InvalidInput(f"{where}.contact_mode", found=found, expected=expected)

    @property
    def key(self) -> str:
        """Full name: dataset/name."""
        return f"{self.dataset}/{self.name}"

    @property
    def duration(self) -> float:
        """Time from the first measured pose to the last [s]."""
        return float(self.trajectory.time[-1] - self.trajectory.time[0])

    def channel(self, name: str) -> Channel | None:
        """Return the channel with a name; None if there is none."""
        return next((channel for channel in self.channels if channel.name == name), None)

    def simulate(self, model: Mapping[str, float] | None = None, **options: Any) -> Any:
        """Simulate the experiment from its first measured pose on.

        Parameters
        ----------
        model : mapping or Calibration, optional
            Values of parameters, such as `{"mu_pusher": 0.2}`, or a calibration; by default the
            values of the scene.
        **options
            `motion`: motion model, such as `"quasistatic"`.

        Returns
        -------
        Simulation

        Raises
        ------
        InvalidInput
            The experiment has no scene, or no measured motion.
        """
        found = offered("methods", "compare")(self, {"model": model}, progress=False, **options)
        return found.rows[0].run.simulation

    @property
    def length_unit(self) -> tuple[str, float]:
        """Unit for displaying lengths, and its size [m]: micrometres for small parts.

        The size of a part without an outline is that of its displacement.
        """
        reach = float(np.ptp(self.trajectory.pose[:, :2], axis=0).max())
        if self.scene is not None:
            own = [body for body in self.scene.bodies if body.name == self.object_name]
            reach = max(float(np.hypot(*np.asarray(one.shape.outline).T).max()) for one in own)
        return length_unit(reach)

    def _summary(self) -> Summary:
        kind = "real" if self.real else f"simulated by {self.simulated_by}"
        n, (unit, metre) = len(self.trajectory.time), self.length_unit
        rows = [
            (end, *(pose[:2] / metre).tolist(), degrees(pose[2]))
            for end, pose in zip(("start", "end"), self.trajectory.pose[[0, -1]], strict=True)
        ]
        place = (Column("x", unit, ".2f"), Column("y", unit, ".2f"))
        table = Table((self.object_name, *place, Column("angle", "deg", ".2f")), rows)
        values = (
            f"{name}={value if isinstance(value, str | bool) else format(value + 0.0, '.6g')}"
            for name, value in self.conditions.items()
        )
        notes = [" ".join(values)] if self.conditions else []
        notes += [f"contact mode at the end: {self.contact_mode}"] if self.contact_mode else []
        notes += [] if self.scene else ["no scene: it can be drawn, but not simulated"]
        notes += [f"{flag.name}: {flag.detail}" for flag in self.flags]
        heading = f"Experiment {self.key}, {kind}: {counted(n, 'frame')}, {self.duration:.2f} s"
        return Summary(heading, [table], notes)

    def _repr_html_(self) -> str:
        picture = offered("methods", "thumbnail")(self)
        return f'{self._summary().html()}<div style="width:18em">{picture}</div>'

    def _data(self) -> Table:
        """Measured poses in SI units."""
        head = (Column("time", "s"), Column("x", "m"), Column("y", "m"), Column("theta", "rad"))
        return Table(head, np.column_stack((self.trajectory.time, self.trajectory.pose)).tolist())

    def flagged(self, *flags: Flag) -> Experiment:
        """Return the experiment with flags added."""
        return replace(self, flags=(*self.flags, *flags))


_KINDS: Final[Mapping[str, tuple[Any, str]]] = {
    "trajectory": (Trajectory, "a Trajectory"), "pusher": (Trajectory | None, "a Trajectory"),
    "scene": (Scene | None, "a Scene"), "provenance": (Provenance, "a Provenance"),
    "real": (bool | np.bool_, "True or False"),
    **dict.fromkeys(("object_name", "simulated_by", "contact_mode", "video"), (str, "a text")),
}  # fmt: skip


def _several(value: Any, kind: type, where: str) -> tuple[Any, ...]:
    found = tuple(value) if isinstance(value, Iterable) else (value,)
    for k, one in enumerate(found):
        instance(one, kind, f"{where}[{k}]", f"a {kind.__name__}")
    return found


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedExperiment(Comparable):
    """Experiment of a sampling plan: scene and name.

    Parameters
    ----------
    name : str
        Name, unique in its plan; alphabetical order is the order of the plan.
    scene : Scene
        Scene with one free body, one pusher with a force-limited drive, and fixels.
    conditions : mapping of str to str or float
        Shape, layout, offset and repetition.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> fixel.PlannedExperiment(name="push-1", scene=pushed_square()).name
    'push-1'
    """

    name: str
    scene: Scene
    conditions: Mapping[str, str | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        name_of(self.name, "planned.name")
        instance(self.scene, Scene, "planned.scene", "a Scene")
        settle(self, conditions=conditions_of(self.conditions, "planned.conditions"))
