"""Input of a calibration, as stored in its job folder: parameters, methods and experiments."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Self, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, PlainValidator, create_model

from fixel.calibration import OPTIMISERS, AbstractOptimiser, MultiStart, PatternSearch, objective
from fixel.calibration.least_squares import LeastSquares
from fixel.calibration.noise import Noise
from fixel.calibration.target import Target
from fixel.errors import InvalidInput, check_name
from fixel.formats.scene_file import SceneRecord, scene_content, scene_of
from fixel.io.array_bytes import arrays_of, bytes_of
from fixel.io.atomic import readable
from fixel.model.fields import name_of
from fixel.model.parameters import in_si, info_of
from fixel.model.space import SHARE_OF_RANGE, ParameterSpace, Unknown
from fixel.registry import offered
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import FloatArray

Error = TypeVar("Error", float, FloatArray)
Search = AbstractOptimiser | LeastSquares
Method = TypeVar("Method", bound=objective.AbstractError | Search)

AUTO: Final = "auto"
SEARCHES: Final[tuple[type[Search], ...]] = (LeastSquares, *OPTIMISERS)
ENOUGH: Final = 10  # residuals an unknown, for least squares unless asked for another search
TARGETS: Final = "targets.json"
POSES: Final = "poses.npz"
STRICT: Final = ConfigDict(extra="forbid", frozen=True)


def _unknown(content: Any) -> Unknown:
    """Return an unknown, from its plain content if necessary.

    Earlier versions allowed bounds below the smallest value of a parameter, which none can have.
    """
    if isinstance(content, Unknown):
        return content
    own = dict(content)
    if {"name", "low", "nominal"} <= own.keys():
        lowest = info_of(own["name"]).lowest
        own |= {key: max(own[key], lowest) for key in ("low", "nominal")}
    return Unknown(**own)


PlainUnknown = Annotated[Unknown, PlainValidator(_unknown), PlainSerializer(Unknown.plain)]


class NamedOptions(BaseModel):
    """A member of a family by its name, with its options."""

    model_config = STRICT

    name: str
    options: dict[str, Any] = {}


def named_options(choice: Any, where: str) -> NamedOptions:
    """Return a method by name with its options, from a name, a mapping or the object itself."""
    if isinstance(choice, NamedOptions):
        return choice
    if isinstance(choice, str):
        return NamedOptions(name=choice)
    if isinstance(choice, Mapping) and "name" in choice:
        options = {key: value for key, value in choice.items() if key != "name"}
        return NamedOptions(name=str(choice["name"]), options=options)
    if isinstance(choice, objective.AbstractError | AbstractOptimiser):
        names = [own.name for own in dataclasses.fields(choice)]  # type: ignore[arg-type]
        options = {name: getattr(choice, name) for name in names}
        return NamedOptions(name=choice.name, options=options)
    raise InvalidInput(where, found=choice, expected="a name, or a mapping with a name and options")


def _fields() -> dict[str, Any]:
    """Return the fields of a request; those of options as the signature of `calibrate` has them.

    They have the order of stored requests, since the bytes of one name the folder of its job.
    """
    known = offered("capability", "calibrate").model.model_fields
    fields: dict[str, Any] = {name: (own.annotation, own) for name, own in known.items()}
    (kind, usual), (mode, _) = fields.pop("level"), get_args(known["mode"].annotation)
    fields |= {
        "level": (kind | None, usual),  # None in records of earlier versions, which lack it
        "mode": (mode, "each"),
        "unknowns": (list[PlainUnknown], ...),
        "error": (NamedOptions, NamedOptions(name="mean-square")),
        "optimiser": (NamedOptions, NamedOptions(name=PatternSearch.name)),
        "noise_position": (float | None, None),
        "noise_angle": (float | None, None),
        "stored": (list[list[float]], []),
        "sample_of": (Annotated[int, Field(ge=1)] | None, None),
    }
    others = """error motion optimiser starts combine seed noise_position noise_angle level
        verdicts stored budget sample_of max_evaluations"""
    return {name: fields[name] for name in ("name", "mode", "unknowns", *others.split())}


if TYPE_CHECKING:

    class _Fields(BaseModel):
        def __getattr__(self, name: str) -> Any: ...

else:
    _Fields = create_model("_Fields", __config__=STRICT, **_fields())


class CalibrationRequest(_Fields):
    """A calibration to be.

    Its other fields are options of `fixel.calibrate`.

    Attributes
    ----------
    mode : str
        `"each"`: every experiment by itself. `"joint"`: one set of parameters for all.
        `"campaign"`: each, then neighbours' values, then one set in every way of the thesis.
        `"stored"`: no search, but the one of `stored` whose largest error is smallest.
    unknowns : list of Unknown
    noise_position, noise_angle : float, optional
        Standard deviations of the measured poses [m, rad]; found out where left out.
    stored : list of list of float
        Values of the free unknowns in earlier calibrations.
    sample_of : int, optional
        Number of experiments that those calibrated were drawn from at random; None where all of
        them are.
    """

    @property
    def space(self) -> ParameterSpace:
        """Parameters to search, with their bounds."""
        return ParameterSpace(unknowns=tuple(self.unknowns))

    @property
    def made_error(self) -> objective.AbstractError:
        """The error of one experiment."""
        return _made(objective.ERRORS, self.error)

    @property
    def made_search(self) -> Search:
        """The search by errors or by residuals, from one start or several."""
        choice, error = self.optimiser, self.made_error
        if choice.name == LeastSquares.name:
            options: dict[str, Any] = {"starts": self.starts}
            if isinstance(error, objective.Robust):
                # Residuals are in millimetres.
                options |= {"loss": "soft_l1", "width": 1e3 * error.distance}
            choice = NamedOptions(name=choice.name, options=options | choice.options)
        made = _made(SEARCHES, choice)
        if self.starts == 1 or isinstance(made, LeastSquares):
            return made
        return MultiStart(optimiser=made, starts=self.starts)

    @property
    def sums_squares(self) -> bool:
        """Whether one set of parameters is searched whose error is a sum of squares."""
        sums = self.combine != "largest" and self.error.name != objective.RootMeanSquare.name
        return bool(sums and self.mode == "joint")

    def with_usual_search(self, targets: Sequence[Target]) -> Self:
        """Return the request with the search that suits it best, if it has `"auto"`.

        Least squares for one set of parameters of several experiments, where the error is a sum of
        squares (also softened ones) and there are several residuals an unknown; else pattern
        search.
        """
        if self.optimiser.name != AUTO:
            return self
        ends = self.error.name == objective.EndPose.name
        n_residuals = 3 * sum(1 if ends else len(target.pose) for target in targets)
        enough = len(targets) > 1 and n_residuals >= ENOUGH * len(self.space.free)
        name = (LeastSquares if self.sums_squares and enough else PatternSearch).name
        search = self.optimiser.model_copy(update={"name": name})
        return self.model_copy(update={"optimiser": search})

    @property
    def made_motion(self) -> AbstractMotionModel:
        """The motion model, or another engine."""
        return motion_model(self.motion)

    @property
    def noise(self) -> Noise | None:
        """Noise of the measured poses, as stated; None if it is to be estimated."""
        if self.noise_position is None or self.noise_angle is None:
            return None
        return Noise(position_m=self.noise_position, angle_rad=self.noise_angle, source="stated")

    def error_of_one(self, error: Error, n: int) -> Error:
        """Return the share of one of n experiments in a combined error, where that is a sum."""
        return error / n if self.combine == "sum" else error

    def lengths(self, errors: FloatArray, n: int = 1) -> FloatArray:
        """Return combined errors of n experiments as lengths of one [mm], for charts and tables."""
        return objective.lengths_of(self.error_of_one(errors, n), self.made_error.unit)

    def listed(self) -> dict[str, str | float]:
        """Return the values that records have for lists, by name; without the parameters."""
        found: dict[str, str | float] = {}
        for name in CalibrationRequest.model_fields:
            value, own = getattr(self, name), {}
            if isinstance(value, NamedOptions):
                own = {name: value.name, **{f"{name}.{k}": x for k, x in value.options.items()}}
            elif isinstance(value, str | int | float):
                own = {name: value}
            found |= {k: float(x) if isinstance(x, int | float) else str(x) for k, x in own.items()}
        return found

    def check(self) -> None:
        """Refuse what cannot be, before any work starts."""
        if self.name.startswith(".") or set(self.name) & set("/\\"):
            expected = "a name for a folder, without / and without a leading dot"
            raise InvalidInput("name", found=repr(self.name), expected=expected)
        name_of(self.name, "name")
        if self.level is None:
            raise InvalidInput("level", found=None, expected="a number between 0 and 1")
        if self.mode == "stored" and not self.stored:
            found = "no stored calibration with values of all these parameters"
            expected, hint = "at least one", "calibrate each first"
            raise InvalidInput("mode stored", found=found, expected=expected, hint=hint)
        if self.budget is not None and self.mode != "joint":
            raise InvalidInput("budget", found=f"mode {self.mode}", expected="mode joint")
        if isinstance(self.made_search, LeastSquares) and not self.sums_squares:
            found = f"mode {self.mode}, combine {self.combine}, error {self.error.name}"
            expected = "mode joint and a sum or mean of squares"
            where, hint = f"optimiser {LeastSquares.name}", "choose pattern-search or nelder-mead"
            raise InvalidInput(where, found=found, expected=expected, hint=hint)
        _ = self.space, self.made_error, self.made_motion, self.noise


NAMED: Final = tuple(
    name for name, own in CalibrationRequest.model_fields.items() if own.annotation is NamedOptions
)


def _made(family: Sequence[type[Method]], choice: NamedOptions) -> Method:
    """A member of a family, by its name and options."""
    where = "error" if family is objective.ERRORS else "optimiser"
    known: dict[str, Any] = {member.name: member for member in family}
    check_name(where, choice.name, known)
    member = known[choice.name]
    options = {field.name for field in dataclasses.fields(member)}
    for name in choice.options:
        check_name(f"option of {where} {choice.name}", name, sorted(options))
    made: Method = member(**choice.options)
    return made


def target_files(targets: Sequence[Target]) -> dict[str, bytes]:
    """Return the files that contain targets, by name."""
    content = [
        {
            "key": target.key,
            "conditions": dict(target.conditions),
            "scene": scene_content(target.case.scene),
            "samples": len(target.pose),
            "starts_measured": target.starts_measured,
        }
        for target in targets
    ]
    poses = bytes_of(
        time=np.concatenate([target.case.times for target in targets]),
        pose=np.concatenate([target.pose for target in targets]),
    )
    return {TARGETS: json.dumps(content, allow_nan=False).encode(), POSES: poses}


def read_targets(folder: Path) -> list[Target]:
    """Load the targets from a folder; bit-exact inverse of `target_files`."""
    with readable(folder):
        content = json.loads((folder / TARGETS).read_text(encoding="utf-8"))
        arrays = arrays_of((folder / POSES).read_bytes())
        ends = np.cumsum([entry["samples"] for entry in content])[:-1]
        return [
            Target(
                entry["key"],
                entry["conditions"],
                RolloutCase(scene_of(SceneRecord.model_validate(entry["scene"])), time),
                pose,
                bool(entry.get("starts_measured")),
            )
            for entry, time, pose in zip(
                content, np.split(arrays["time"], ends), np.split(arrays["pose"], ends), strict=True
            )
        ]


# --- options of a stored request ----------------------------------------------------------------

# Functions that begin a run of another mode than joint or stored.
FUNCTIONS: Final = {"each": "calibrate_each", "campaign": "calibrate_campaign"}
# Parameters that let a wrong model fit better: pressure is hardly ever centred...
CENTRE: Final = ("friction_centre_x", "friction_centre_y")
PRESSURE: Final = "pressure_spread"  # ... and hardly ever on a tripod
IDEAL: Final = ("tripod_radius", "ellipsoid_force", "ellipsoid_torque")  # replaced by PRESSURE


def options_of(request: CalibrationRequest, experiments: Iterable[int | str]) -> dict[str, Any]:
    """Return the options of the command that repeats a calibration of experiments.

    Its parameters must not be restricted to conditions, which needs a file.
    """
    capability = offered("capability", "calibrate")
    free = (u for u in request.unknowns if not u.frozen)
    own = {name: getattr(request, name, None) for name in capability.options}
    own = {k: v.name if isinstance(v, NamedOptions) else v for k, v in own.items()}
    own |= {
        **request.error.options,
        "space": None,  # stated by the next two
        "experiments": [*map(str, experiments)],
        "fit": [f"{u.name}={u.low:.9g}:{u.high:.9g}:{u.nominal:.9g}" for u in free],
        "fixed": [f"{u.name}={u.nominal:.9g}" for u in request.unknowns if u.frozen],
        "option": [f"{name}={value}" for name, value in request.optimiser.options.items()],
    }
    known = {k: v for k, v in own.items() if k in capability.options and v is not None}
    plain: dict[str, Any] = capability.request(known).model_dump(mode="json")
    return plain


def call_of(request: CalibrationRequest, source: str) -> str:
    """Return the Python expression of a calibration; `source` is that of the experiments."""

    def text(value: Any) -> str:
        if isinstance(value, Noise):
            return f"fixel.Noise(position_m={value.position_m!r}, angle_rad={value.angle_rad!r})"
        if isinstance(value, NamedOptions):
            return repr({"name": value.name, **value.options} if value.options else value.name)
        return repr(value)

    space = ", ".join(f"{u.label!r}: {_bounds_text(u)}" for u in request.unknowns)
    words = [source, f"{{{space}}}"]
    for name, usual in signature(offered("capability", "calibrate").of).parameters.items():
        own = text(getattr(request, name, usual.default))
        if own != repr(usual.default) and name != "name":
            words.append(f"{name}={own}")
    return f"fixel.{FUNCTIONS.get(request.mode, 'calibrate')}({', '.join(words)})"


def _bounds_text(unknown: Unknown) -> str:
    """Expression of the bounds of a parameter, or of its value if it is fixed."""
    if unknown.frozen:
        return repr(unknown.nominal)
    words = [repr(unknown.low), repr(unknown.high)]
    if unknown.prior is None:
        words.append(f"start={unknown.nominal!r}")
    else:
        words.append(f"prior={(unknown.nominal, unknown.prior)!r}")
    if unknown.scale != SHARE_OF_RANGE * (unknown.high - unknown.low):
        words.append(f"scale={unknown.scale!r}")
    return f"fixel.Parameter({', '.join(words)})"


def command_of(options: Mapping[str, Any]) -> str:
    """Return the shell command with these options, of which `project` is the project's folder."""
    capability, own = offered("capability", "calibrate"), dict(options)
    folder = Path(own.pop("project", ""))
    command: str = capability.command(capability.request(own), folder)
    return command


def enlarged_command(options: Mapping[str, Any], request: CalibrationRequest) -> str:
    """Return the command that calibrates a larger model; empty if there is no larger model.

    `options` are those of the command of the calibration.
    """
    known = {unknown.name for unknown in request.unknowns}
    replaced = known & {*IDEAL}
    more = [*([PRESSURE] if replaced else []), *(() if known & {*CENTRE} else CENTRE)]
    # A file defines the parameters completely, so that no other can be added.
    if "project" not in options or not more or options.get("space") or options.get("dakota"):
        return ""
    fit = options.get("fit") or [u.name for u in request.unknowns if not u.frozen]
    own = {
        name: [one for one in settings if in_si(one.partition("=")[0].strip())[0] not in replaced]
        for name, settings in (("fit", fit), ("fixed", options.get("fixed", ())))
    }
    return command_of({**options, **own, "fit": [*own["fit"], *more]})
