"""Goal files, YAML: what a plan should reach, what it may choose, and what is known.

Lengths are in millimetres and angles in degrees, and keys name their units. Poses and regions are
in the frame of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats import records
from fixel.io.document import document
from fixel.model import Disk, Polygon, goals
from fixel.model.parameters import info_of
from fixel.planning.belief import Belief, RigError
from fixel.planning.pushes import Cost, FreePushes, RigPushes
from fixel.uncertainty.error_terms import StartError, preset
from fixel.uncertainty.run_to_run import RunToRun

Range = Annotated[list[records.Number], Field(min_length=2, max_length=2)]
Names = Annotated[list[str], Field(min_length=1)]
Values = dict[str, records.Number | Range]

ENDINGS: Final = {"m": "_mm", "rad": "_deg"}  # of keys of parameters, by unit

records.record_of(goals.PoseRegion, "goal", units=True, symmetry=Annotated[int, Field(ge=1)])
_SEATED: Any = records.record_of(goals.Seated, "goal", units=True, fixels=Names)
_SEATED.makes = lambda fixels, **own: goals.Seated(*fixels, **own)
records.record_of(goals.Beyond, "goal", units=True)
records.record_of(goals.Contact, "goal", units=True)
for _kind in (goals.Inside, goals.Exit):
    records.record_of(
        _kind, "goal", units=True, names={"region": "region_mm"}, region=records.Corners
    )
EventRecord: Any = records.choice_of(
    "EventRecord", contact=goals.Contact, exit=goals.Exit, force_above=goals.ForceAbove
)
_GoalForms: Any = records.choice_of(
    "_GoalForms",
    pose=goals.PoseRegion,
    seated=goals.Seated,
    inside=goals.Inside,
    beyond=goals.Beyond,
)


class GoalRecord(_GoalForms):  # type: ignore[misc]
    """Goal, in exactly one form, with events that must never happen."""

    all: list[GoalRecord] | None = Field(None, description="goals to meet together")
    any: list[GoalRecord] | None = Field(None, description="goals of which one suffices")
    never: list[EventRecord] = Field([], description="events that must never happen")


records.record_of(
    FreePushes,
    "choose",
    units=True,
    names={"length": "length_mm", "turn": "turn_deg", "obstacles": "obstacles_mm"},
    most=Annotated[int, Field(ge=1, le=4)],
    tool=records.choice_of("ToolRecord", disk_mm=Disk, polygon_mm=Polygon),
    length=Range,
    turn=Range,
    cost=Cost,
    obstacles=list[records.Corners],
    keep=list[str],
)
_AXES: Final = {"x": "x_mm", "y": "y_mm", "theta": "theta_deg"}
records.record_of(
    RigPushes,
    "choose",
    units=True,
    names=_AXES | {"stroke": "stroke_mm", "fixels": "fixels_mm", "obstacles": "obstacles_mm"},
    fixels=dict[str, Annotated[list[Range], Field(min_length=2, max_length=2)]],
    x=Range,
    y=Range,
    theta=Range,
    stroke=Range,
    cost=Cost,
    obstacles=list[records.Corners],
    keep=list[str],
)
ChooseRecord: Any = records.choice_of("ChooseRecord", free=FreePushes, rig=RigPushes)
StartRecord: Any = records.record_of(
    StartError,
    "start_error",
    units=True,
    kind=Literal["uniform", "normal"],
    more={"preset": (str | None, Field(None, description="asme or rpi-camera"))},
)
RigErrorRecord: Any = records.record_of(RigError, "belief.rig", units=True)


class BeliefRecord(records.FileRecord):
    """Unknowns of a plan."""

    calibration: int | None = Field(None, ge=1, description="id of a stored calibration")
    parameters: Values = Field(
        {},
        description="values or [low, high] by parameter; lengths have keys such as "
        "tripod_radius_mm, others are in SI units",
    )
    start: StartRecord | None = Field(None, description="error of the start pose")
    rig: RigErrorRecord | None = Field(None, description="errors of the rig")
    camera: StartRecord | None = Field(None, description="error of a pose seen between pushes")
    lost_views: Annotated[records.Number, Field(ge=0.0, lt=1.0)] = Field(
        0.0, description="share of the looks that see nothing"
    )
    run_to_run: Literal["learned", "none"] = Field(
        "none",
        description="learned: scatter between runs from experiments that repeat pushes, instead of"
        " the error of the calibrated model",
    )
    friction_scatter: Annotated[records.Number, Field(ge=0.0, lt=1.0)] | None = Field(
        None,
        description="relative scatter of the friction of tool and fixels between runs, such as 0.2,"
        " instead of the error of the calibrated model",
    )
    conditions: dict[str, str | records.Number] = Field(
        {}, description="labels that select parameters"
    )


class WantRecord(records.FileRecord):
    """Wanted success probability."""

    success: records.Fraction = Field(0.95, description="wanted success probability")
    confidence: records.Fraction = Field(0.95, description="confidence level of its bound")


class GoalFileRecord(records.FileRecord):
    """Content of a goal file."""

    fixel: Literal[1] = Field(description="version of the format")
    scene: str | None = Field(None, description="scene file, relative to this file")
    goal: GoalRecord = Field(description="goal of the plan")
    choose: ChooseRecord | None = Field(None, description="pushes that may be chosen")
    belief: BeliefRecord | None = Field(None, description="parameters, errors of start and rig")
    want: WantRecord = Field(WantRecord(success=0.95, confidence=0.95), description="wanted")


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalFile:
    """Content of a goal file."""

    goal: goals.Goal
    choose: FreePushes | RigPushes | None = None
    belief: Belief = field(default_factory=Belief)  # without the parameters of `calibration`
    calibration: int | None = None  # id of the stored calibration whose parameters the belief takes
    # Whether the scatter between runs is learned from the experiments of the calibration.
    run_to_run: bool = False
    # Error of a pose that is seen between pushes and share of the looks that see nothing, where the
    # file states them, by the names that they have in `plan`.
    views: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    scene: Path | None = None  # scene file
    # Wanted success probability, and confidence level of its bound.
    success: float = 0.95
    confidence: float = 0.95
    # Content of the file.
    raw: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def load_goal(path: str | Path) -> GoalFile:
    r"""Load a goal file: YAML, or JSON if the name ends in `.json`.

    Raise `InvalidInput` for the first error, with the path of its key.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "fixel: 1\ngoal: {pose: {pose_mm_deg: [180, 0, 0], position_mm: 2}}\n"
    >>> _ = Path("goal.yaml").write_text(text)
    >>> print(load_goal("goal.yaml").goal)
    the part within 2 mm of (180, 0) mm, 0 deg
    """
    path = Path(path)
    with document(path, "goal file") as raw:
        return goal_file_from_dict(raw, path.parent)


def goal_file_from_dict(raw: Any, folder: Path | None = None) -> GoalFile:
    """Build a goal file from its content; scene files are searched in `folder`."""
    record = records.validated(GoalFileRecord, raw, "goal file")
    known = record.belief or BeliefRecord.model_validate({})
    views: dict[str, Any] = {"lost_views": known.lost_views}
    if known.camera is not None:
        views["camera"] = _error(known.camera, "belief.camera")
    return GoalFile(
        goal=_goal(record.goal, "goal"),
        choose=None if record.choose is None else records.made(record.choose, "choose"),
        belief=_belief(known, "belief"),
        calibration=known.calibration,
        run_to_run=known.run_to_run == "learned",
        views=MappingProxyType(views),
        scene=None if record.scene is None else (folder or Path()) / record.scene,
        success=record.want.success,
        confidence=record.want.confidence,
        raw=MappingProxyType(dict(raw)),
    )


# --- from records ---------------------------------------------------------------------------------


def _goal(record: Any, path: str) -> goals.Goal:
    form = records.only_form(
        record, path, [key for key in type(record).model_fields if key != "never"]
    )
    inner: Any = getattr(record, form)
    where = f"{path}.{form}"
    never = [records.made(one, f"{path}.never[{k}]") for k, one in enumerate(record.never)]
    goal: goals.Goal
    if isinstance(inner, list):
        parts = [_goal(one, f"{where}[{k}]") for k, one in enumerate(inner)]
        with records.within(where, "goal"):
            if form == "all":
                return goals.AllOf(*parts, never=never)
            goal = goals.AnyOf(*parts)
    else:
        goal = records.made(inner, where)
    return goals.AllOf(goal, never=never) if never else goal


def _belief(record: BeliefRecord, path: str) -> Belief:
    if record.calibration is not None and record.parameters:
        raise InvalidInput(path, found="calibration and parameters", expected="one of them")
    scatter = record.friction_scatter
    if scatter is not None and record.run_to_run == "learned":
        raise InvalidInput(path, found="two kinds of scatter", expected="one of them")
    with records.within(path, "belief"):
        return Belief(
            parameters=_parameters(record.parameters) or None,
            start=None if record.start is None else _error(record.start, "start"),
            rig=None if record.rig is None else records.made(record.rig, "rig"),
            run_to_run=None if scatter is None else RunToRun.of_friction(scatter),
            conditions=record.conditions,
        )


def _parameters(given: Values) -> dict[str, Any]:
    """Return values and intervals in SI units by parameter."""
    found = {}
    for key, value in given.items():
        name, own = records.si_field(key, value)
        expected = name + ENDINGS.get(info_of(name).unit, "")
        if key != expected:
            hint = "keys of lengths and angles name their unit: values are in mm and degrees"
            raise InvalidInput(f"parameters.{key}", found=key, expected=expected, hint=hint)
        found[name] = tuple(own) if isinstance(own, list) else own
    return found


def _error(record: Any, where: str) -> StartError:
    """Return the error of a start, or of a seen pose, by its preset or its sizes."""
    if record.preset is None:
        error: StartError = records.made(record, where)
        return error
    if any(own != type(record).model_fields[key].default for key, own in record if key != "preset"):
        raise InvalidInput(where, found="a preset and sizes", expected="one of them")
    with records.within(where):
        return preset(record.preset)
