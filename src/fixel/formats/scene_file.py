"""Scene files, YAML or JSON: their schema, all inputs of a rollout, and overrides of values."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, final, get_origin

from pydantic import ConfigDict, Field

from fixel import model
from fixel.errors import InvalidInput, closest, number_of
from fixel.formats import records
from fixel.formats.records import content
from fixel.io.atomic import write_whole
from fixel.io.document import document, parse_yaml, yaml_text
from fixel.model.parameters import KNOWN_PARAMETERS, in_si

if TYPE_CHECKING:
    from fixel.simulation.stepping import AbstractStepper

MAX_KEYS = 1000  # maximum number of keys in one mapping; scenes have about ten

Waypoint = Annotated[list[records.Number], Field(min_length=4, max_length=4)]
Pair = Annotated[list[records.Positive], Field(min_length=2, max_length=2)]

# Placeholder in a template for a value that only the user knows.
FILL_IN: Final = "FILL_IN"


def _drive(**given: Any) -> model.Drive:
    forms = [form for form in ("direction", "waypoints") if form in given]
    if len(forms) != 1:
        found = " and ".join(forms) or None
        raise InvalidInput("drive", found=found, expected="exactly one of direction, waypoints")
    if forms == ["direction"]:
        if "speed" not in given:
            raise InvalidInput("drive.speed", found=None, expected="a speed [m/s]")
        return model.LineDrive(**given)
    for key in ("speed", "travel"):
        if key in given:
            found = f"a {key} in addition to waypoints"
            raise InvalidInput(f"drive.{key}", found=found, expected="only waypoints")
    return model.PathDrive(**given)


class DriveRecord(records.FileRecord):
    """Drive of a pusher: either a direction with a speed, or waypoints."""

    model_config = ConfigDict(
        json_schema_extra={"oneOf": [{"required": ["direction"]}, {"required": ["waypoints"]}]}
    )
    makes, word = staticmethod(_drive), "drive"

    direction: records.Point | None = Field(
        None, description="direction of the motion in world axes"
    )
    speed: records.NonNegative | None = Field(None, description="speed of the motion [m/s]")
    travel: records.NonNegative | None = Field(
        None, description="distance after which the drive stops [m]"
    )
    waypoints: list[Waypoint] | None = Field(
        None, description="poses of the motion: t [s], x [m], y [m], angle [rad]"
    )
    force_limit: records.Positive | None = Field(
        None, description="force at which the drive stalls [N]"
    )


records.use_record(DriveRecord, model.LineDrive, model.PathDrive, model.Drive)
ShapeRecord: Any = records.choice_of(
    "ShapeRecord", model.Shape, polygon=model.Polygon, disk=model.Disk
)
NoneRecord: Any = records.record_of(model.NoSupport, "none")
TripodRecord: Any = records.record_of(model.Tripod, "tripod")
PointsRecord: Any = records.record_of(
    model.SupportPoints,
    "points",
    names={"points": "at"},
    friction=records.NonNegative | list[records.NonNegative],
    loads=list[records.NonNegative],
)
UniformRecord: Any = records.record_of(
    model.UniformPressure, "uniform", n_points=Annotated[int, Field(ge=3, le=100_000)]
)
records.record_of(model.Ellipsoid, "ellipsoid")
SupportRecord: Any = records.choice_of(
    "SupportRecord",
    model.Support,
    tripod=model.Tripod,
    points=model.SupportPoints,
    uniform=model.UniformPressure,
    ellipsoid=model.Ellipsoid,
    none=model.NoSupport,
)
records.record_of(model.Spring, "spring")
records.record_of(model.Body, "body", required=["pose"])
records.record_of(model.Pusher, "pusher", required=["drive"])
records.record_of(model.Fixel, "fixel")
records.record_of(model.PairFriction, "contact_friction")
records.record_of(model.FrictionMap, "friction_map", cell=Pair, factor=list[list[records.Positive]])
records.record_of(model.LoadMap, "load_map", cell=Pair, log_load=list[list[records.Number]])
records.record_of(model.Plane, "plane", anisotropy=Pair)
SceneRecord: Any = records.record_of(
    model.Scene,
    "",
    first=["fixel", "gravity", "duration"],
    required=["duration"],
    support_directions=Annotated[int, Field(ge=4)],
    more={
        "fixel": (Literal[1], Field(1, description="version of the format")),
        "motion": (Literal["dynamic", "quasistatic", "first-order"], "dynamic"),
        "step": (
            records.Positive | None,
            Field(None, description="time step [s]; by default the stepper chooses"),
        ),
        "output_interval": (
            records.Positive | None,
            Field(
                None,
                description="time between two samples of the trajectory [s]; by default every step",
            ),
        ),
    },
)


def scene_of(record: Any) -> model.Scene:
    """Build the scene that a validated record describes; errors have the path of their key."""
    scene: model.Scene = records.made(record)
    return scene


def scene_content(scene: model.Scene) -> dict[str, Any]:
    """Return a scene as the keys of a scene file, mostly without defaults; raise for a template."""
    found: dict[str, Any] = content(scene.complete())  # a template could not be read again
    return found


def scene_record(raw: Any) -> SceneRecord:
    """Validate every key and kind of value in the raw content of a scene file."""
    _refuse_many_keys(raw)
    try:
        return records.validated(SceneRecord, raw, "scene")
    except InvalidInput:
        if left := list(_placeholders(raw)):
            raise _unfilled(left) from None
        raise


def _refuse_many_keys(raw: Any, where: str = "scene") -> None:
    """Reject huge mappings, before validation creates an error for each of their keys."""
    if isinstance(raw, dict) and len(raw) > MAX_KEYS:
        raise InvalidInput(where, found=f"{len(raw)} keys", expected=f"at most {MAX_KEYS}")
    for value in raw.values() if isinstance(raw, dict) else raw if isinstance(raw, list) else ():
        if isinstance(value, dict | list):
            _refuse_many_keys(value, where)


def _placeholders(raw: Any, path: records.KeyPath = ()) -> Iterator[records.KeyPath]:
    """Yield the paths of placeholders that are left from a template."""
    if raw == FILL_IN:
        yield path
    entries = (
        raw.items() if isinstance(raw, dict) else enumerate(raw) if isinstance(raw, list) else ()
    )
    for key, value in entries:
        yield from _placeholders(value, (*path, key))


def _unfilled(left: list[records.KeyPath]) -> InvalidInput:
    first, record = left[0], records.record_at(SceneRecord, left[0])
    forms = [f"{{{k}: {v.description}}}" for k, v in record.model_fields.items()] if record else []
    also = ", ".join(records.written(path) for path in left[1:])
    value = records.description_at(SceneRecord, first) or "see the scene file"
    return InvalidInput(
        records.written(first),
        found=f"the placeholder {FILL_IN}",
        expected=" or ".join(forms) or f"a value: {value}",
        hint=f"{FILL_IN} also remains at {also}" if also else None,
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFile:
    """Scene with the method that its file requests.

    Parameters
    ----------
    scene : Scene
        Scene of the file.
    motion : str
        Motion model: `dynamic`, `quasistatic` or `first-order`.
    step : float or None
        Time step [s]; None: the stepper's own choice.
    output_interval : float or None
        Time between recorded poses [s]; None: every step.
    """

    scene: model.Scene
    motion: str = "dynamic"
    step: float | None = None
    output_interval: float | None = None

    @property
    def stepper(self) -> AbstractStepper:
        """Stepper with the step of the file; adaptive if it has none."""
        from fixel.simulation.stepping import Adaptive, StewartTrinkle

        return Adaptive() if self.step is None else StewartTrinkle(step=self.step)


def load_scene(path: str | Path, overrides: Sequence[str] = ()) -> SceneFile:
    """Load a scene file.

    Parameters
    ----------
    path : str or Path
        Scene file: YAML, or JSON if the name ends in `.json`.
    overrides : sequence of str
        Changes as `path.to.key=value`, applied in order before validation.

    Returns
    -------
    SceneFile
        Scene, and the method that the file requests; `simulate` takes both.

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import pushed_square
    >>> file = load_scene(pushed_square().save("square.yaml"), ["duration=0.5"])
    >>> file.scene.duration
    0.5
    >>> fixel.simulate(file).duration
    0.5
    """
    with document(path, "scene file") as raw:
        if not overrides:
            return scene_file_from_dict(raw)
    return scene_file_from_dict(raw, overrides)  # its errors may be those of the overrides


def scene_file_from_dict(raw: Mapping[str, Any], overrides: Sequence[str] = ()) -> SceneFile:
    """Build a scene file from its content as dicts and lists; see `load_scene`."""
    changed = copy.deepcopy(raw) if overrides else raw
    for override in overrides:
        apply_override(changed, override)
    record = scene_record(changed)
    return SceneFile(
        scene=scene_of(record),
        motion=record.motion,
        step=record.step,
        output_interval=record.output_interval,
    )


def scene_dict(scene_file: SceneFile) -> dict[str, Any]:
    """Content of a scene file as dicts and lists, mostly without defaults."""
    method = {
        "motion": scene_file.motion,
        "step": scene_file.step,
        "output_interval": scene_file.output_interval,
    }
    given = {key: value for key, value in method.items() if value is not None}
    return {"fixel": 1, **given, **scene_content(scene_file.scene)}


def save_scene(scene_file: SceneFile, path: str | Path) -> None:
    """Write a scene file: YAML, or JSON if the name ends in `.json`."""
    path = Path(path)
    content = scene_dict(scene_file)
    if path.suffix.lower() == ".json":
        text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    else:
        text = yaml_text(content)
    write_whole(path, text)


def scene_json_schema() -> dict[str, Any]:
    """JSON schema of scene files, for editors and other programs."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "fixel scene file",
        **{k: v for k, v in SceneRecord.model_json_schema().items() if k != "title"},
    }


def split_settings(settings: Iterable[str]) -> tuple[list[str], dict[str, float]]:
    """Return those settings that change a key of a scene, and the values of parameters [SI].

    A setting is `PATH=VALUE`, or the name of a parameter with a number.
    """
    keys, overrides, values = list(SceneRecord.model_fields), list[str](), dict[str, float]()
    for setting in settings:
        written, equals, text = setting.partition("=")
        name, factor = in_si(written.strip())
        first = re.split(r"[.\[]", name)[0]
        if not equals or closest(first, [*keys, *KNOWN_PARAMETERS]) in keys:
            overrides.append(setting)
            continue
        values[name] = factor * number_of(text, name)
    return overrides, values


def apply_override(raw: Any, override: str) -> None:
    """Change one value of a raw scene in place: `path.to.key=value`, the value in YAML.

    List items are addressed by number or, if they have one, by name. A key missing in the file is
    added if scene files allow it there.
    """
    text, equals, value = override.partition("=")
    if not equals or not text.strip():
        raise InvalidInput(
            f"overrides {override}", found="no value", expected="path.to.key=value, or NAME=value"
        )
    segments = re.sub(r"\[(\d+)\]", r".\1", text.strip()).split(".")
    container = raw
    path: records.KeyPath = ()
    for segment in segments[:-1]:
        key = _key(container, segment, path)
        if isinstance(container, dict) and container.get(key) is None:
            container[key] = _empty_at((*path, key))
        container, path = container[key], (*path, key)
    key = _key(container, segments[-1], path)
    container[key] = parse_yaml(value, f"overrides {override}")


def _key(container: Any, segment: str, path: records.KeyPath) -> str | int:
    """Key or list index that a segment of a path refers to in a container."""
    if isinstance(container, list):
        names = [item.get("name") if isinstance(item, dict) else None for item in container]
        if segment in names:
            return names.index(segment)
        if segment.isascii() and segment.isdecimal() and int(segment) < len(container):
            return int(segment)
        there = ", ".join(str(name) for name in names if name is not None)
        expected = f"a number below {len(container)}" + (f", or one of {there}" if there else "")
        raise InvalidInput(
            f"{records.written(path)}.{segment}", found="no such index", expected=expected
        )
    if isinstance(container, dict):
        record = records.record_at(SceneRecord, path)
        if segment in container or (record and segment in record.model_fields):
            return segment
        raise records.unknown_key(SceneRecord, (*path, segment))
    raise InvalidInput(
        ".".join((records.written(path), segment)).removeprefix("."),
        found=f"{container!r} at {records.written(path) or 'the top'}",
        expected="a list or a mapping",
    )


def _empty_at(path: records.KeyPath) -> dict[str, Any] | list[Any] | None:
    """Empty container to insert for a missing key: a list, a dict, or None for a value."""
    if get_origin(records.annotation_at(SceneRecord, path)) is list:
        return []
    return {} if records.record_at(SceneRecord, path) else None
