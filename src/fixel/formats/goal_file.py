"""Goal files, YAML: what a plan should reach, what it may choose, and what is known.

Lengths are in millimetres and angles in degrees, and keys name their units. Poses and regions are
in the frame of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, final

from pydantic import Field

from fixel.errors import InvalidInput
from fixel.formats.records import (
    FileRecord,
    Fraction,
    NonNegative,
    Number,
    Point,
    Positive,
    Triple,
    built,
    only_form,
    si_field,
    si_fields,
    validated,
    within,
)
from fixel.io.document import read_document
from fixel.model import Disk, Polygon
from fixel.model.goals import (
    AllOf,
    AnyOf,
    Beyond,
    Contact,
    Exit,
    ForceAbove,
    Goal,
    Inside,
    PoseRegion,
    Seated,
)
from fixel.model.parameters import info_of
from fixel.planning.belief import Belief, RigError
from fixel.planning.pushes import FreePushes, RigPushes
from fixel.uncertainty.starts import StartError, preset

Range = Annotated[list[Number], Field(min_length=2, max_length=2)]
Corners = Annotated[list[Point], Field(min_length=3)]
Values = dict[str, Number | Range]

ON_PART: Final = "free body; by default the only one"
ENDINGS: Final = {"m": "_mm", "rad": "_deg"}  # of keys of parameters, by unit
_KINDS: Final[dict[str, Any]] = {"pose": PoseRegion, "inside": Inside, "beyond": Beyond}
GAP: Final = "largest gap that counts as contact [mm]; by default 0.1 % of the part's size"


class PoseGoalRecord(FileRecord):
    pose_mm_deg: Triple = Field(description="pose of the part: x, y [mm], angle [deg]")
    position_mm: Positive | None = Field(None, description="allowed distance of the centroid [mm]")
    angle_deg: Positive | None = Field(None, description="allowed difference of angles [deg]")
    symmetry: int = Field(1, ge=1, description="rotations by which the outline covers itself")
    body: str | None = Field(None, description=ON_PART)


class SeatedRecord(FileRecord):
    fixels: Annotated[list[str], Field(min_length=1)] = Field(description="fixels to touch")
    only: bool = Field(False, description="whether no other fixel may be touched")
    stalled: bool = Field(False, description="whether the drive must have stalled")
    tolerance_mm: Positive | None = Field(None, description=GAP)
    body: str | None = Field(None, description=ON_PART)


class RegionRecord(FileRecord):
    region_mm: Corners = Field(description="corners x, y of a region in the world [mm]")
    tolerance_mm: Positive | None = Field(None, description="allowed protrusion [mm]")
    body: str | None = Field(None, description=ON_PART)


class BeyondRecord(FileRecord):
    line_mm: Annotated[list[Point], Field(min_length=2, max_length=2)] = Field(
        description="two points; the goal is left of the way from the first to the second [mm]"
    )
    feature_mm: Point | None = Field(
        None, description="point of the part [mm]; by default its whole outline"
    )
    tolerance_mm: Positive | None = Field(None, description="allowed shortfall [mm]")
    body: str | None = Field(None, description=ON_PART)


class ContactRecord(FileRecord):
    fixel: str = Field(description="fixel that must not be touched")
    tolerance_mm: Positive | None = Field(None, description=GAP)
    body: str | None = Field(None, description=ON_PART)


class EventRecord(FileRecord):
    """Event that must never happen, in exactly one form."""

    contact: ContactRecord | None = Field(None, description="the part touches a fixel")
    exit: RegionRecord | None = Field(None, description="the part leaves a region")
    force_above: Positive | None = Field(None, description="force of the drive [N]")


class GoalRecord(FileRecord):
    """Goal, in exactly one form, with events that must never happen."""

    pose: PoseGoalRecord | None = Field(None, description="the part ends near a pose")
    seated: SeatedRecord | None = Field(None, description="the part touches fixels")
    inside: RegionRecord | None = Field(None, description="the part is inside a region")
    beyond: BeyondRecord | None = Field(None, description="the part is beyond a line")
    all: list[GoalRecord] | None = Field(None, description="goals to meet together")
    any: list[GoalRecord] | None = Field(None, description="goals of which one suffices")
    never: list[EventRecord] = Field([], description="events that must never happen")


class ToolRecord(FileRecord):
    """Shape of a tool, in exactly one form."""

    disk_mm: Positive | None = Field(None, description="radius of a disk [mm]")
    polygon_mm: Corners | None = Field(
        None, description="corners of a polygon whose x axis points along the push [mm]"
    )


class FreePushesRecord(FileRecord):
    most: int = Field(1, ge=1, le=4, description="largest number of pushes in sequence")
    tool: ToolRecord | None = Field(None, description="tool; by default the scene's pusher")
    length_mm: Range | None = Field(None, description="least and largest way after contact [mm]")
    angle_deg: NonNegative = Field(30.0, description="largest angle to the normal [deg]")
    clearance_mm: Positive | None = Field(None, description="gap where the tool is put down [mm]")
    retract_mm: NonNegative | None = Field(None, description="way back before lifting [mm]")
    speed: Positive = Field(0.02, description="speed of the tool [m/s]")
    friction: NonNegative | None = Field(None, description="friction of the tool on the part")
    force_limit: Positive | None = Field(None, description="force at which the drive stalls [N]")


class RigPushesRecord(FileRecord):
    x_mm: Range = Field([0.0, 0.0], description="range of the placement along x [mm]")
    y_mm: Range = Field([0.0, 0.0], description="range of the placement along y [mm]")
    theta_deg: Range = Field([0.0, 0.0], description="range of the placement's angle [deg]")
    stroke_mm: Range | None = Field(None, description="least and largest stroke [mm]")
    fixels_mm: dict[str, Annotated[list[Range], Field(min_length=2, max_length=2)]] = Field(
        {}, description="ranges along x and y in which fixels may be displaced [mm]"
    )
    retract_mm: NonNegative = Field(0.0, description="way back before the end [mm]")


class ChooseRecord(FileRecord):
    """Pushes that may be chosen, in exactly one form."""

    free: FreePushesRecord | None = Field(None, description="pushes of a tool that can be lifted")
    rig: RigPushesRecord | None = Field(None, description="placement and stroke on one axis")


class StartRecord(FileRecord):
    """Error of the start pose: a preset, or sizes of errors."""

    preset: str | None = Field(None, description="asme or rpi-camera")
    x_mm: NonNegative = Field(0.0, description="size of the error of x [mm]")
    y_mm: NonNegative = Field(0.0, description="size of the error of y [mm]")
    theta_deg: NonNegative = Field(0.0, description="size of the error of the angle [deg]")
    kind: Literal["uniform", "normal"] | None = Field(
        None,
        description="required with sizes: half-widths (uniform) or standard deviations (normal)",
    )


class RigErrorRecord(FileRecord):
    path_mm: NonNegative = Field(0.0, description="standard deviation across the path [mm]")
    heading_deg: NonNegative = Field(0.0, description="standard deviation of the heading [deg]")
    travel_mm: NonNegative = Field(0.0, description="standard deviation along the path [mm]")
    fixels_mm: NonNegative = Field(0.0, description="standard deviation of places of fixels [mm]")


class BeliefRecord(FileRecord):
    calibration: int | None = Field(None, ge=1, description="id of a stored calibration")
    parameters: Values = Field(
        {},
        description="values or [low, high] by parameter; lengths have keys such as "
        "tripod_radius_mm, others are in SI units",
    )
    start: StartRecord | None = Field(None, description="error of the start pose")
    rig: RigErrorRecord | None = Field(None, description="errors of the rig")
    run_to_run: Literal["learned", "none"] = Field(
        "learned", description="scatter between runs, learned from the experiments"
    )
    conditions: dict[str, str | Number] = Field({}, description="labels that select parameters")


class WantRecord(FileRecord):
    success: Fraction = Field(0.95, description="wanted success probability")
    confidence: Fraction = Field(0.95, description="confidence level of its bound")


class GoalFileRecord(FileRecord):
    """Content of a goal file."""

    fixel: Literal[1] = Field(description="version of the format")
    scene: str | None = Field(None, description="scene file, relative to this file")
    goal: GoalRecord = Field(description="goal of the plan")
    choose: ChooseRecord | None = Field(None, description="pushes that may be chosen")
    belief: BeliefRecord | None = Field(None, description="parameters, errors of start and rig")
    want: WantRecord = Field(WantRecord(success=0.95, confidence=0.95), description="wanted")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class GoalFile:
    """Content of a goal file.

    Attributes
    ----------
    goal : Goal
    choose : FreePushes or RigPushes or None
    belief : Belief
        Without the parameters of `calibration`.
    calibration : int or None
        Id of the stored calibration whose parameters the belief takes.
    run_to_run : bool
        Whether the scatter between runs is learned from the experiments of the calibration.
    scene : Path or None
        Scene file.
    success, confidence : float
        Wanted success probability, and confidence level of its bound.
    raw : mapping
        Content of the file.
    """

    goal: Goal
    choose: FreePushes | RigPushes | None = None
    belief: Belief = field(default_factory=Belief)
    calibration: int | None = None
    run_to_run: bool = True
    scene: Path | None = None
    success: float = 0.95
    confidence: float = 0.95
    raw: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def load_goal(path: str | Path) -> GoalFile:
    """Load a goal file: YAML, or JSON if the name ends in `.json`.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    GoalFile

    Raises
    ------
    InvalidInput
        The first error, with the path of its key.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "fixel: 1\\ngoal: {pose: {pose_mm_deg: [180, 0, 0], position_mm: 2}}\\n"
    >>> _ = Path("goal.yaml").write_text(text)
    >>> print(load_goal("goal.yaml").goal)
    the part within 2 mm of (180, 0) mm, 0 deg
    """
    path = Path(path)
    return goal_file_from_dict(read_document(path, "goal file"), path.parent)


def goal_file_from_dict(raw: Any, folder: Path | None = None) -> GoalFile:
    """Build a goal file from its content; scene files are searched in `folder`."""
    record = validated(GoalFileRecord, raw, "goal file")
    known = record.belief
    return GoalFile(
        goal=_goal(record.goal, "goal"),
        choose=None if record.choose is None else _choice(record.choose, "choose"),
        belief=Belief() if known is None else _belief(known, "belief"),
        calibration=None if known is None else known.calibration,
        run_to_run=known is None or known.run_to_run == "learned",
        scene=None if record.scene is None else (folder or Path()) / record.scene,
        success=record.want.success,
        confidence=record.want.confidence,
        raw=MappingProxyType(dict(raw)),
    )


def goal_json_schema() -> dict[str, Any]:
    """JSON schema of goal files, for editors and other programs."""
    schema = GoalFileRecord.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "fixel goal file",
    }


# --- from records ---------------------------------------------------------------------------------


def _goal(record: GoalRecord, path: str) -> Goal:
    forms = ("pose", "seated", "inside", "beyond", "all", "any")
    form = only_form(record, path, forms)
    inner: Any = getattr(record, form)
    where = f"{path}.{form}"
    never = [_event(one, f"{path}.never[{k}]") for k, one in enumerate(record.never)]
    goal: Goal
    if isinstance(inner, list):
        parts = [_goal(one, f"{where}[{k}]") for k, one in enumerate(inner)]
        with within(where, "goal", "."):
            if form == "all":
                return AllOf(*parts, never=never)
            goal = AnyOf(*parts)
    elif isinstance(inner, SeatedRecord):
        fields = si_fields(inner)
        with within(where, "goal."):
            goal = Seated(*fields.pop("fixels"), **fields)
    else:
        goal = built(_KINDS[form], inner, where, "goal.")
    return AllOf(goal, never=never) if never else goal


def _event(record: EventRecord, path: str) -> Any:
    form = only_form(record, path)
    inner: Any = getattr(record, form)
    if form == "force_above":
        return ForceAbove(inner)
    return built(Contact if form == "contact" else Exit, inner, f"{path}.{form}", "goal.")


def _choice(record: ChooseRecord, path: str) -> FreePushes | RigPushes:
    form = only_form(record, path)
    path = f"{path}.{form}"
    if record.free is not None:
        tool = record.free.tool
        return built(
            FreePushes,
            record.free,
            path,
            "choose.",
            tool=None if tool is None else _tool(tool, f"{path}.tool"),
            length=_pair(si_fields(record.free)["length"]),
        )
    own = record.rig
    assert own is not None
    fields = si_fields(own)
    pairs = {name: _pair(fields[name]) for name in ("x", "y", "theta", "stroke")}
    moved = {name: (_pair(x), _pair(y)) for name, (x, y) in fields["fixels"].items()}
    return built(RigPushes, own, path, "choose.", **pairs, fixels=moved or None)


def _tool(record: ToolRecord, path: str) -> Disk | Polygon:
    only_form(record, path)
    own = si_fields(record)
    with within(path):
        return Disk(own["disk"]) if own["disk"] is not None else Polygon(own["polygon"])


def _pair(values: Any) -> Any:
    return None if values is None else tuple(values)


def _belief(record: BeliefRecord, path: str) -> Belief:
    if record.calibration is not None and record.parameters:
        raise InvalidInput(path, found="calibration and parameters", expected="one of them")
    start, rig = record.start, record.rig
    with within(path, "belief."):
        return Belief(
            parameters=_parameters(record.parameters) or None,
            start=None if start is None else _start(start),
            rig=None if rig is None else RigError(**si_fields(rig)),
            conditions=record.conditions,
        )


def _parameters(given: Values) -> dict[str, Any]:
    """Return values and intervals in SI units by parameter."""
    found = {}
    for key, value in given.items():
        name, own = si_field(key, value)
        expected = name + ENDINGS.get(info_of(name).unit, "")
        if key != expected:
            hint = "keys of lengths and angles name their unit: values are in mm and degrees"
            raise InvalidInput(f"parameters.{key}", found=key, expected=expected, hint=hint)
        found[name] = tuple(own) if isinstance(own, list) else own
    return found


def _start(record: StartRecord) -> StartError:
    own = si_fields(record)
    name = own.pop("preset")
    if name is None:
        with within("start", "start_error."):
            return StartError(**own | {"kind": record.kind or ""})
    if own["x"] or own["y"] or own["theta"] or record.kind:
        raise InvalidInput("start", found="a preset and sizes", expected="one of them")
    with within("start"):
        return preset(name)
