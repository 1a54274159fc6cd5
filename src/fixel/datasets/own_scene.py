"""Scenes for your own tables: completion of a scene file by measurements, and a template."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from fixel.datasets import contact
from fixel.datasets.base import trajectory_of
from fixel.errors import InvalidInput
from fixel.formats.scene_file import FILL_IN, SceneFile, scene_of, scene_record
from fixel.io.document import document, yaml_text
from fixel.model import Disk, Experiment, Flag, PathDrive, Pusher, Scene, Shape, Trajectory
from fixel.model.fields import instance
from fixel.model.scene import SceneChoice
from fixel.model.shape import length_scale, rotated
from fixel.typing import BoolArray, FloatArray

# A pusher that stays farther from the object than this many radii of the object is in another unit
# or frame.
FARTHEST: Final = 5.0

# Share of the instants at which a pusher must be inside the object to be flagged.
OFTEN: Final = 0.1
# If a pusher is deeper inside the object than this share of its radius with one unit of angles,
# and less than a quarter as deep with the other, the other unit is meant.
INSIDE: Final = 0.03

# [m] Distance from a pusher beyond which it does not move the object, and motion worth a remark: at
# a friction of 0.25 an object of 0.2 m/s coasts 8 mm.
ALONE: Final = 0.01

FAR_AWAY: Final = 1e3  # [m], distance from all bodies

NOMINAL_FRICTION: Final = 0.25


def with_scene(
    experiment: Experiment,
    choice: SceneChoice,
    object_name: str | None = None,
    *,
    sure_of_angles: bool = False,
) -> tuple[Experiment, tuple[str, ...]]:
    """Complete an experiment with a scene; return it and sentences on how that was done.

    The object starts at the first measured pose. A pusher whose path was measured follows it, and
    the scene lasts as long as the table. The choice is a scene, which may be a template, a scene
    file, or a function of the experiment's conditions. `object_name` is the body whose motion was
    measured, required if there are several. With `sure_of_angles`, header and user state the same
    unit of the angles, which is then not checked. A placeholder that was not replaced, an unknown
    body, or a pusher whose measured position is impossible raises `InvalidInput`.
    """
    scene, source = _scene(choice, experiment)
    body = _object_of(scene, source, object_name)
    track, flags = experiment.trajectory, experiment.flags
    if any(flag.name == "no-angle" for flag in flags) and not isinstance(body.shape, Disk):
        raise InvalidInput(
            experiment.provenance.source or experiment.name,
            found=f"no angle of {body.name!r}, which a simulation of its outline needs",
            expected="a column such as theta_deg, or a quaternion qx, qy, qz, qw",
            hint="in Python, columns={'theta': TITLE} chooses one; if the part did not turn, add a"
            " column of zeros",
        )
    sentences = [f"{source}: {body.name!r} starts at the first measured pose."]
    pushers = scene.pushers
    if experiment.pusher is not None:
        pusher = _pusher_of(scene, source)
        paths = track, experiment.pusher
        driven, more, sentence = _driven(pusher, body.shape, *paths, source, sure_of_angles)
        pushers, flags = (driven,), (*flags, *more)
        sentences.append(sentence)
        if scene.fixels and driven.drive.force_limit is None:
            sentences.append(
                f"{pusher.name!r} has no limit of force: it jams when a part is seated against the"
                " fixels. Describe a drive that stalls in the scene, such as"
                " drive=LineDrive(speed=0.01, force_limit=30)."
            )
    elif any(pusher.is_template for pusher in pushers):
        raise InvalidInput(
            source,
            found=f"a pusher {pushers[0].name!r} without a drive, and a table without its poses",
            expected="columns pusher_x and pusher_y, or a drive",
            hint="in Python, columns={'pusher_x': TITLE} chooses one",
        )
    elif pushers:
        sentences.append(f"The table has no pusher: {pushers[0].name!r} moves as in the scene.")
    completed = replace(
        scene,
        bodies=tuple(
            replace(one, pose=track.pose[0]) if one is body else one for one in scene.bodies
        ),
        pushers=pushers,
        duration=max(float(track.time[-1]), (scene.duration or 0.0) if not pushers else 0.0),
    )
    found = replace(
        experiment,
        scene=completed,
        object_name=body.name,
        flags=tuple(flag for flag in flags if flag.name != "no-scene"),
    )
    return found, tuple(sentences)


def template_text(experiment: Experiment, source: str) -> str:
    """Return the text of a scene file with the data of a table, and placeholders for the rest."""
    start = np.round(experiment.trajectory.pose[0], 9).tolist()
    body: dict[str, Any] = {
        "name": experiment.object_name,
        "shape": FILL_IN,
        "mass": FILL_IN,
        "pose": start,
        "support": {"uniform": {"friction": NOMINAL_FRICTION}},
    }
    content: dict[str, Any] = {
        "fixel": 1,
        "duration": float(experiment.trajectory.time[-1]) or 1.0,
        "motion": "quasistatic",
        "bodies": [body],
    }
    if experiment.pusher is not None:
        path = np.column_stack((experiment.pusher.time, experiment.pusher.pose))[[0, -1]]
        content["pushers"] = [
            {
                "name": "pusher",
                "shape": FILL_IN,
                "drive": {"waypoints": np.round(path, 9).tolist()},
                "friction": NOMINAL_FRICTION,
            }
        ]
    return f"{_HEAD.format(source=source, fill=FILL_IN)}{yaml_text(content)}"


_HEAD: Final = """\
# Scene of {source}. Lengths in m, angles in rad, masses in kg. Replace every {fill}:
#   shape of the object   {{polygon: [[x, y], ...]}}, corners in order, in the frame whose pose
#                         is in the table; or {{disk: radius}}
#   mass                  in kg; it does not matter to quasi-static motion
#   shape of the pusher   {{disk: radius}} for a round tip, or {{polygon: ...}}
# Frictions are nominal values: calibrate them. Starting pose, path of the pusher and duration come
# from the table each time it is imported; pegs can be added under the key fixels.
"""


def _scene(choice: SceneChoice, experiment: Experiment) -> tuple[Scene, str]:
    """Return the scene for an experiment, and its name in messages."""
    if isinstance(choice, Path):
        return _loaded(choice, experiment), choice.name
    conditions = {**experiment.conditions, "name": experiment.name}
    made: Any = choice(conditions) if callable(choice) else choice
    scene = made.scene if isinstance(made, SceneFile) else made
    instance(scene, Scene, "scene", "a Scene, a scene file, or a function that returns a Scene")
    return scene, "scene"


def _loaded(path: Path, experiment: Experiment) -> Scene:
    """Load the scene of a file; a pusher whose path was measured is moved far away.

    With the poses of the file, from another run or with noise, the two might overlap. What the
    measurement states may be missing in the file: duration, start pose and drive.
    """
    away = [[time, FAR_AWAY, FAR_AWAY, 0.0] for time in (0.0, 1.0)]
    track, tip = experiment.trajectory, experiment.pusher
    stated = [("bodies", "pose", track.pose[0].tolist())]
    stated += [] if tip is None else [("pushers", "drive", {"waypoints": away})]
    with document(path, "scene file") as raw:
        if isinstance(raw, dict):
            raw.setdefault("duration", float(track.time[-1]) or 1.0)
            for kind, key, value in stated:
                match raw.get(kind):
                    case [dict() as only]:
                        only.setdefault(key, value)
        record = scene_record(raw)
        for pusher in record.pushers if tip is not None else ():
            pusher.pose = None
            pusher.drive.direction = pusher.drive.speed = pusher.drive.travel = None
            pusher.drive.waypoints = away
        return scene_of(record)


def _object_of(scene: Scene, source: str, name: str | None) -> Any:
    names = [body.name for body in scene.bodies]
    if name is None and len(names) == 1:
        return scene.bodies[0]
    if name not in names:
        raise InvalidInput(
            f"{source}: bodies",
            found=", ".join(names) or "none",
            expected="one body, the object" if name is None else f"the object {name!r}",
            hint="object_name=NAME names the body that was measured",
        )
    return scene.bodies[names.index(name)]


def _pusher_of(scene: Scene, source: str) -> Pusher:
    if len(scene.pushers) != 1:
        expected = "one pusher, since the table has the path of one"
        found = f"{len(scene.pushers)} pushers"
        raise InvalidInput(f"{source}: pushers", found=found, expected=expected)
    return scene.pushers[0]


def _driven(
    pusher: Pusher, shape: Shape, track: Trajectory, tip: Trajectory, source: str, sure: bool
) -> tuple[Pusher, tuple[Flag, ...], str]:
    """Move the pusher to its measured path, corrected if it starts inside the object.

    Raise for an impossible path of a round tip, or a wrong unit of angles if it is not `sure`.
    """
    if track.time[-1] == 0.0:
        where, expected = f"{source} and the table", "a motion for the pusher of the scene"
        raise InvalidInput(where, found="one row of poses", expected=expected)
    measured = np.column_stack((tip.time, tip.pose))
    flags: tuple[Flag, ...] = ()
    sentence = f"{pusher.name!r} follows its measured path"
    if isinstance(pusher.shape, Disk):
        gaps, offset = _gaps(shape, pusher.shape.radius, track, tip)
        _refuse_strangers(shape, gaps, source)
        if not sure:
            _refuse_other_angles(shape, pusher.shape.radius, track, tip, gaps)
        if gaps[0] < 0.0:
            flags = (contact.correction_flag(float(gaps[0])),)
            measured = contact.corrected_path(measured, offset[0], contact.FADE)
            sentence += f", moved out of the object at the start, {-1e3 * gaps[0]:.3g} mm"
        least, first = 1e3 * float(gaps.min()), 1e3 * float(gaps[0])
        how = "overlaps the outline by up to" if least < 0.0 else "comes as near to the outline as"
        sentence += f"; its surface {how} {abs(least):.3g} mm"
        sentence += "." if first < 0.0 else f", and was {first:.3g} mm from it at the start."
        scale = length_scale(shape)
        if (deep := -float(np.quantile(gaps, OFTEN))) > scale * contact.MAX_CORRECTION:
            flags = (*flags, Flag("pusher-inside-object", f"often by {1e3 * deep:.3g} mm or more"))
            sentence += (
                " It is often deep inside the object, so the experiment is flagged and "
                "not listed by default."
            )
        far = scale * ALONE
        if (alone := _moved_alone(track.at(tip.time)[:, :2], gaps > far)) > far:
            detail = f"{1e3 * alone:.3g} mm while the pusher was more than {1e3 * far:.3g} mm away"
            flags = (*flags, Flag("moved-alone", detail, fault=False))
            sentence += f" The object moved {detail}: did it coast, or was it lifted?"
    else:
        sentence += "."
    limit = None if pusher.is_template else pusher.drive.force_limit
    drive = PathDrive(waypoints=measured, force_limit=limit)
    return replace(pusher, pose=measured[0, 1:], drive=drive), flags, sentence


def _moved_alone(place: FloatArray, far: BoolArray) -> float:
    """Largest distance [m] between positions (n, 2) during which the pusher stayed far away."""
    spans = np.split(place, np.flatnonzero(far[1:] != far[:-1]) + 1)
    first = 0 if far[0] else 1  # spans with the pusher far away and near alternate
    return max((float(np.hypot(*(own[-1] - own[0]))) for own in spans[first::2]), default=0.0)


def _gaps(
    shape: Shape, radius: float, track: Trajectory, tip: Trajectory
) -> tuple[FloatArray, FloatArray]:
    """Gaps (n,) from the surface of the tip to the outline, and shifts (n, 2) to contact [m]."""
    return contact.moved_to_contact(shape, radius, track.at(tip.time), tip.pose[:, :2])


def _refuse_other_angles(
    shape: Shape, radius: float, track: Trajectory, tip: Trajectory, gaps: FloatArray
) -> None:
    """Raise if the pusher passes through the object with this unit of angles but not the other."""
    own = -float(np.quantile(gaps, OFTEN))
    if own <= INSIDE * _radius(shape):
        return
    for unit, other, factor in (("rad", "deg", np.pi / 180.0), ("deg", "rad", 180.0 / np.pi)):
        turned, _ = _gaps(shape, radius, rescaled(track, factor), tip)
        if -float(np.quantile(turned, OFTEN)) < 0.25 * own:
            raise InvalidInput(
                "angles of the object",
                found=f"a pusher {1e3 * own:.3g} mm inside the object for a tenth of the time",
                expected=f"a pusher outside, as with angles in {WORDS[other]}",
                hint=hint_of(other, unit),
            )


def _radius(shape: Shape) -> float:
    return float(np.hypot(*np.asarray(shape.outline).T).max())


def _refuse_strangers(shape: Shape, gaps: FloatArray, source: str) -> None:
    """Raise for a pusher that starts deep inside the object, or never comes near it."""
    size = _radius(shape)
    hint = (
        "check the units of the table, the frame of its poses, which is that of the outline, and "
        "that outline and tip are in metres"
    )
    first, least = 1e3 * float(gaps[0]), 1e3 * float(gaps.min())
    if gaps[0] < -length_scale(shape) * contact.MAX_CORRECTION:
        found = f"a pusher {-first:.3g} mm inside the object at the start"
        expected = "a pusher that touches it at most"
    elif float(gaps.min()) > FARTHEST * size:
        found = f"a pusher that stays {least:.3g} mm from an object of radius {1e3 * size:.3g} mm"
        expected = "a pusher close to the object"
    else:
        return
    raise InvalidInput(f"{source} and the table", found=found, expected=expected, hint=hint)


WORDS: Final = {"deg": "degrees", "rad": "radians"}

FASTEST_TURN: Final = 6.0  # [rad/s], a turn per second; pushed parts turn at up to about 2
MAX_TURN: Final = 4.0 * math.pi  # [rad] of values as in the file; more is rather in degrees
WINDOW: Final = 0.1  # [s] for rates of turning, long enough to average noise of the angle
FASTEST: Final = 5.0  # [m/s]
WIDEST: Final = 5.0  # [m] of motion of a part on a plate
OUTERMOST: Final = 20.0  # [m] of positions from the origin, which may be in a corner of the room
GLANCES: Final = 60  # number of instants at which a motion is sampled; more would add up noise
# A pushing tip hardly slides along the object. The unit of angles is wrong if the tip slides this
# many times farther in the object's frame than with the other unit.
FEWER_TIMES: Final = 8.0
MIN_SLIP: Final = 0.1  # share of the distance from the object to the tip; less is noise
MIN_TURN: Final = 0.05  # [rad] with either unit; less decides nothing


def refuse_implausible(
    track: Trajectory, tip: Trajectory | None, source: str, where: str, unit: str | None
) -> None:
    """Raise `InvalidInput` for positions and angles whose unit in the header cannot be right.

    The object moves or turns faster, or moves farther, than is possible on a plate; radians make it
    turn more than twice; or the tip would slide along it far less with the other unit. Tracks of
    object and tip are in the units of the header, with angles not unwrapped. Table and column of
    angles, `source` and `where`, are for the message. The unit is None for a table without angles.
    """
    glance = np.linspace(track.time[0], track.time[-1], GLANCES)
    _refuse_lengths(track, source)
    if unit not in WORDS or len(track.time) < 3:
        return
    # The other unit, and the factor from this one to it.
    other, factor = ("deg", math.pi / 180.0) if unit == "rad" else ("rad", 180.0 / math.pi)
    angle = _without_jumps(track.theta)
    rate = _turning(track.time, angle)
    if rate > FASTEST_TURN:
        step = max(WINDOW, float(np.median(np.diff(track.time))))
        found = f"an object that turns {math.degrees(rate * step):.3g} degrees in {step:.3g} s"
        # Values that were radians under a title in degrees would make it turn even faster.
        _refuse(where, found, unit, other if unit == "rad" else None)
    turn = float(min(np.ptp(angle), np.ptp(track.theta)))
    if unit == "rad" and turn > MAX_TURN:
        _refuse(where, f"an object that turns {math.degrees(turn):.4g} degrees", unit, other)
    if tip is None:
        return
    here, there = rescaled(track, 1.0), rescaled(track, factor)
    slip, slip_other = _slip(here, tip, glance), _slip(there, tip, glance)
    arm = float(np.median(np.hypot(*(tip.at(glance) - track.at(glance))[:, :2].T)))
    turn = max(float(np.ptp(one.pose[:, 2])) for one in (here, there))
    if turn > MIN_TURN and slip > MIN_SLIP * arm and slip > FEWER_TIMES * slip_other:
        _refuse(
            where,
            f"a pusher that moves {1e3 * slip:.3g} mm along the object, against"
            f" {1e3 * slip_other:.3g} mm with angles in {other}",
            unit,
            other,
        )


def _refuse(where: str, found: str, unit: str, other: str | None) -> None:
    expected = f"the motion of a pushed object, with angles in {WORDS[unit]}"
    raise InvalidInput(where, found=found, expected=expected, hint=hint_of(other, unit))


def hint_of(other: str | None, unit: str) -> str:
    """Hint with the likely unit of angles, and the two statements that confirm the other one."""
    ways = f"set angle_unit={other} with --option, or in Python units={{'angle': '{other}'}}"
    likely = f"it is likely in {WORDS[other]}: {ways}" if other else "check angles and times"
    sure = f"if it is in {WORDS[unit]}, end its title with _{unit} and set angle_unit={unit}"
    return f"{likely}; {sure}"


def _refuse_lengths(track: Trajectory, source: str) -> None:
    width = float(np.ptp(track.pose[:, :2], axis=0).max())
    reach = float(np.abs(track.pose[:, :2]).max())
    step = np.diff(track.time)
    pace = np.hypot(*np.diff(track.pose[:, :2], axis=0).T) / step if len(step) else np.zeros(1)
    speed = float(np.quantile(pace, 0.75))
    if width > WIDEST or speed > FASTEST or reach > OUTERMOST:
        found = f"a motion of {width:.3g} m" if width > WIDEST else f"a motion of {speed:.3g} m/s"
        if width <= WIDEST and speed <= FASTEST:
            found = f"positions up to {reach:.3g} m"
        raise InvalidInput(
            f"{source}, positions of the object",
            found=found,
            expected=f"at most {WIDEST:g} m and {FASTEST:g} m/s within {OUTERMOST:g} m of 0",
            hint="check the units in the header: x_mm is in millimetres, time_s in seconds",
        )


def _without_jumps(angle: FloatArray) -> FloatArray:
    """Return angles (n,) [rad] without jumps by whole turns, which are no motion in any unit."""
    step = np.diff(angle, prepend=angle[:1])
    turns = 2.0 * math.pi * np.round(step / (2.0 * math.pi))
    return np.asarray(angle - np.cumsum(np.where(np.abs(step - turns) < 0.5, turns, 0.0)))


def _turning(time: FloatArray, angle: FloatArray) -> float:
    """Rate of turning while the object turns [rad/s]."""
    # The first frame of each window.
    _, rows = np.unique(np.floor(time / WINDOW), return_index=True)
    step, turn = np.diff(time[rows]), np.diff(angle[rows])
    rates = np.abs(turn) / step
    moving = rates[np.abs(turn) > 1e-3 * np.abs(turn).max(initial=1e-12)]
    return float(np.quantile(moving, 0.75)) if len(moving) else 0.0


def rescaled(track: Trajectory, factor: float) -> Trajectory:
    """Return a trajectory with its angles multiplied by a factor, then unwrapped."""
    return trajectory_of(track.time, track.pose * (1.0, 1.0, factor))


def _slip(track: Trajectory, tip: Trajectory, glance: FloatArray) -> float:
    """Path length of the tip in the object's frame while the object moves [m]."""
    pose = track.at(glance)
    local = rotated(tip.at(glance) - pose, -pose[:, 2])
    strides = np.hypot(*np.diff(local, axis=0).T)
    moved = np.hypot(*np.diff(pose[:, :2], axis=0).T)
    return float(strides[moved > 0.1 * moved.max(initial=1e-12)].sum())
