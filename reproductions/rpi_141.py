"""RPI's experiment 141: explanations of simulation errors, one at a time and combined.

One run cannot decide between explanations that all fit it. Therefore each has three errors: fitted
to the whole run; fitted to the part before the square meets a fixel, on that part; and with the
latter fit, on the contact with fixel 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, final

import numpy as np

from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.objective import ANGLE_SCALE, Comparer
from fixel.calibration.study import box_of
from fixel.calibration.target import Target, target_of
from fixel.datasets.files import MM, read_table
from fixel.datasets.rpi_2dgad import FRAME_RATE, Rpi2dgad, lab_simulation
from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Experiment,
    PathDrive,
    Scene,
    Support,
    SupportPoints,
    UniformPressure,
)
from fixel.model.space import ParameterSpace, Unknown
from fixel.replay.base import Row
from fixel.simulation import StewartTrinkle
from fixel.simulation.motion import AbstractMotionModel, Dynamic, QuasiStatic
from fixel.typing import FloatArray
from reproductions.charts.pictures import paths_figure
from reproductions.result import Reproduction, RunOptions

EXPERIMENT: Final = "141"

# Frame at which the square meets fixel 2 (its tactile signal comes on at 115).
FREE_UNTIL: Final = 112

# Step of the simulation [s]; 0.15 mm of the actuator. Errors differ by less than 0.3 mm from those
# of the adaptive stepper.
STEP: Final = 1.0 / 60.0

SCALE: Final = np.array([1e3, 1e3, 1e3 * ANGLE_SCALE])  # [mm/m, mm/m, mm/rad]

# Hypotheses in the figure, with their labels.
DRAWN: Final = {
    "as recorded": "before: the laboratory's parameters",
    "push above the plane, friction": "even pressure, push above the plane, friction",
    "support points, friction": "three support points fitted, friction",
}

# (low, high, nominal) of parameters that can be fitted; nominal values are the laboratory's.
BOUNDS: Final[Mapping[str, tuple[float, float, float]]] = {
    "mu_pusher": (0.0, 1.0, 0.3622),
    "mu_support": (0.02, 1.0, 0.4616),
    "mu_fixel": (0.0, 1.5, 0.4209),
    "tripod_radius": (1e-3, 60e-3, 37.2621e-3),
    "registration_x": (-20e-3, 20e-3, 0.0),
    "registration_y": (-5e-3, 5e-3, 0.0),
    "registration_theta": (-0.1, 0.1, 0.0),
    "friction_centre_x": (-30e-3, 30e-3, 0.0),
    "friction_centre_y": (-30e-3, 30e-3, 0.0),
    "anisotropy_xy": (-0.9, 0.9, 0.0),
    "anisotropy_diagonal": (-0.9, 0.9, 0.0),
    "outline_x": (-20e-3, 20e-3, 0.0),
    "outline_y": (-20e-3, 20e-3, 0.0),
    "outline_theta": (-0.1, 0.1, 0.0),
    "start_x": (-3e-3, 3e-3, 0.0),
    "start_y": (-3e-3, 3e-3, 0.0),
    "start_theta": (-0.05, 0.05, 0.0),
    "support_1_x": (-53e-3, 53e-3, 0.0),
    "support_1_y": (-53e-3, 53e-3, 30e-3),
    "support_2_x": (-53e-3, 53e-3, -30e-3),
    "support_2_y": (-53e-3, 53e-3, -20e-3),
    "support_3_x": (-53e-3, 53e-3, 30e-3),
    "support_3_y": (-53e-3, 53e-3, -20e-3),
}
CORNERS: Final = tuple(f"support_{k}_{axis}" for k in (1, 2, 3) for axis in "xy")
NET: Final = SupportPoints(
    points=np.array([[0.0, 30e-3], [-30e-3, -20e-3], [30e-3, -20e-3]]), friction=0.4616
)
EVEN: Final = UniformPressure(friction=0.4616)

# Largest forward shift of the centre of pressure by the push of a head 29.8 mm high: friction of
# the plane, 0.46, times that height [m]. It is along the body's x axis, the direction of the push.
TILT: Final = 13.7e-3

Change = Callable[[Experiment], Experiment]


class HypothesisFit(NamedTuple):
    """Fit of a hypothesis to some frames."""

    values: Mapping[str, float]
    difference: FloatArray  # (n_frame, 3) simulated minus measured, in all useful frames
    pose: FloatArray  # (n_frame, 3)


def run(options: RunOptions) -> Reproduction:
    """Fit and score every hypothesis.

    With `quick`, each fit has one start.
    """
    experiment = experiment_141(options.folder)
    rows: list[Row] = []
    fits: dict[str, HypothesisFit] = {}
    known = HYPOTHESES
    for k, hypothesis in enumerate(known):
        starts = 1 if options.quick else 12 if set(CORNERS) <= set(hypothesis.fitted) else 3
        row, fits[hypothesis.name] = evaluate_hypothesis(experiment, hypothesis, starts)
        rows.append(row)
        options.progress(k + 1, len(known), hypothesis.name)
    laboratory = _laboratory(options.folder)
    others = lateral_misses(options.folder)
    target, pusher = target_of(experiment), experiment.pusher
    assert pusher is not None
    curves = {label: fits[name].pose for name, label in DRAWN.items()}
    draw = partial(
        paths_figure, scene_of(experiment), target.case.times, target.pose, curves,
        pusher.pose[[0, -1]],
    )  # fmt: skip
    return Reproduction(
        tables={"laboratory": [laboratory], "hypotheses": rows, "other_trials": others},
        conclusions=_conclusions(laboratory, rows, others),
        settings={
            "angle_scale_mm_per_rad": 1e3 * ANGLE_SCALE,
            "frames_free": FREE_UNTIL,
            "step_s": STEP,
            "quick": options.quick,
        },
        figure=draw,
    )


def experiment_141(folder: Path) -> Experiment:
    """Load the one complete trial."""
    for experiment in Rpi2dgad().read(folder).experiments():
        if experiment.name == EXPERIMENT:
            return experiment
    raise InvalidInput(str(folder), found="no experiment 141", expected="the complete trial")


# --- fits ---------------------------------------------------------------------------------------


def evaluate_hypothesis(
    experiment: Experiment, hypothesis: Hypothesis, starts: int
) -> tuple[Row, HypothesisFit]:
    """Row of the table for a hypothesis, and its fit to the whole run."""
    for change in hypothesis.changes:
        experiment = change(experiment)
    target = target_of(experiment)
    free = _frames(target.case.times) <= FREE_UNTIL
    whole = fit_hypothesis(target, hypothesis, np.ones(len(free), bool), starts)
    before = fit_hypothesis(target, hypothesis, free, starts) if hypothesis.fitted else whole
    row: Row = {
        "hypothesis": hypothesis.name,
        "together": hypothesis.together,
        "unknowns": len(hypothesis.fitted),
        "rms_mm": rms_mm(whole.difference),
        "position_mm_rms": _position_mm(whole.difference),
        "angle_deg_rms": float(np.degrees(np.sqrt(np.mean(whole.difference[:, 2] ** 2)))),
        "rms_mm_free": rms_mm(before.difference[free]),
        "rms_mm_contact_predicted": rms_mm(before.difference[~free]),
        "values": {name: round(value, 5) for name, value in whole.values.items()},
        "at_bound": at_bound(whole.values),
        "verdict": hypothesis.verdict,
    }
    return row, whole


def _frames(time: FloatArray) -> FloatArray:
    """Numbers of the video frames, counted from 1 at 0 s."""
    return np.asarray(np.rint(time * FRAME_RATE) + 1.0)


def fit_hypothesis(
    target: Target, hypothesis: Hypothesis, use: np.ndarray, starts: int
) -> HypothesisFit:
    """Fit a hypothesis to the frames `use` (n_frame,); return its motion over all frames."""
    names = hypothesis.fitted or ("mu_fixel",)
    space = ParameterSpace(
        unknowns=tuple(
            Unknown(name=name, low=low, high=high, nominal=nominal)
            for name, (low, high, nominal) in BOUNDS.items()
            if name in names
        )
    )
    comparer = Comparer(
        [target], space, motion=hypothesis.motion, stepper=StewartTrinkle(step=STEP)
    )

    def differences(points: FloatArray) -> tuple[FloatArray, np.ndarray]:
        found, good, _ = comparer.differences(np.zeros(len(points), np.int64), points)
        return found, good

    def residuals(points: FloatArray) -> FloatArray:
        found, good = differences(points)
        scaled = found[:, use] * SCALE
        scaled[~good] = np.inf
        return np.asarray(scaled.reshape(len(points), -1))

    point = space.nominal
    if hypothesis.fitted:
        options = LeastSquares(starts=starts, most_iterations=40, tolerance=1e-6)
        point = fit(options.start(box_of(space), 0, comparer.feasible), residuals).point
    difference = differences(point[None])[0][0]
    values = space.values(point) if hypothesis.fitted else {}
    return HypothesisFit(values, difference, difference + target.pose)


def rms_mm(difference: FloatArray) -> float:
    """Root mean square distance of poses (n, 3), with angles at 35 mm/rad [mm]."""
    return float(np.sqrt(np.mean(np.sum((difference * SCALE) ** 2, axis=1))))


def _position_mm(difference: FloatArray) -> float:
    return float(1e3 * np.sqrt(np.mean(np.sum(difference[:, :2] ** 2, axis=1))))


def at_bound(values: Mapping[str, float]) -> list[str]:
    """Names of values that ended within a thousandth of the range of a bound."""
    found = []
    for name, value in values.items():
        low, high, _ = BOUNDS[name]
        if min(value - low, high - value) < 1e-3 * (high - low):
            found.append(name)
    return found


# --- the laboratory's simulation, and its other trials ------------------------------------------


def _laboratory(folder: Path) -> Row:
    experiment, lab = experiment_141(folder), lab_simulation(folder, int(EXPERIMENT))
    if lab is None or experiment.effective is None:
        raise InvalidInput(str(folder), found="no stored simulation", expected="the laboratory's")
    start, end = experiment.effective
    useful = (lab.time >= start) & (lab.time <= end)
    track = experiment.trajectory
    difference = lab.pose - track.pose[np.isin(track.time, lab.time)]
    free = useful & (_frames(lab.time) <= FREE_UNTIL)
    return {
        "rms_mm": rms_mm(difference[useful]),
        "position_mm_rms": _position_mm(difference[useful]),
        "rms_mm_free": rms_mm(difference[free]),
        "rms_mm_all_frames": rms_mm(difference),
    }


def lateral_misses(folder: Path) -> list[Row]:
    """Sideways motion of each trial, measured and in the laboratory's simulation, after 80 % of the
    path. The actuator pushes along -y, so sideways is x."""
    measured, simulated = (
        _tracks(folder, name)
        for name in ("object_trajectory.csv.gz", "author_simulation_trajectory.csv.gz")
    )
    rows: list[Row] = []
    for number in sorted(set(measured) & set(simulated)):
        a, b = measured[number], simulated[number]
        shared = np.intersect1d(a[:, 0], b[:, 0])
        own, other = (t[np.isin(t[:, 0], shared), 1:3] * 1e3 for t in (a, b))
        k = int(0.8 * len(shared))
        moved, expected = own[k] - own[0], other[k] - other[0]
        rows.append(
            {
                "experiment": number,
                "sideways_mm": float(moved[0]),
                "sideways_mm_simulated": float(expected[0]),
                "forward_mm": float(-moved[1]),
                "forward_mm_simulated": float(-expected[1]),
            }
        )
    return rows


def _tracks(folder: Path, name: str) -> dict[int, FloatArray]:
    table = read_table(folder / name)
    numbers = table.numbers("experiment_id").astype(int)
    poses = np.column_stack((table.numbers("frame"), table.stacked("x_mm", "y_mm") * MM))
    return {int(n): poses[numbers == n] for n in np.unique(numbers)}


# --- conclusions and figure ---------------------------------------------------------------------


def _row(rows: Sequence[Row], name: str) -> Row:
    return next(row for row in rows if row["hypothesis"] == name)


def _conclusions(laboratory: Row, rows: list[Row], others: list[Row]) -> list[str]:
    start, even = _row(rows, "as recorded"), _row(rows, "even pressure, friction")
    above = _row(rows, "push above the plane, friction")
    points, grain = (
        _row(rows, "support points, friction"),
        _row(rows, "plane with a grain, friction"),
    )
    miss = {
        row["experiment"]: abs(row["sideways_mm"] - row["sideways_mm_simulated"]) for row in others
    }
    far = sorted(number for number, value in miss.items() if value > 5.0)
    slope = _sideways_slope([row for row in others if row["experiment"] not in far])
    return [
        f"The laboratory's simulation is {laboratory['rms_mm']:.1f} mm RMS off"
        f" ({laboratory['rms_mm_all_frames']:.1f} over all its frames); with the right gravity its"
        f" parameters give {start['rms_mm']:.1f} mm. Its slip of units hides 2 mm.",
        "Speed, inertia and the filter of the actuator's path change the error by 0.7 mm at most;"
        " registration and start pose help only with shifts that the pictures rule out.",
        f"The support helps: even pressure with no friction at the actuator leaves"
        f" {even['rms_mm_free']:.1f} mm before the fixel, with the centre of pressure moved"
        f" forward by a push above the plane {above['rms_mm_free']:.1f} mm.",
        f"To fit the whole run to 1 mm takes freedom that one run cannot check: free support points"
        f" ({points['unknowns']} unknowns, {points['rms_mm']:.1f} mm) or a plane with a grain"
        f" ({grain['unknowns']} unknowns, {grain['rms_mm']:.1f} mm). Fitted before the fixel, they"
        f" predict the contact to {points['rms_mm_contact_predicted']:.1f} and"
        f" {grain['rms_mm_contact_predicted']:.1f} mm only.",
        f"A grain of the plane would show in all trials. Of {len(miss)}, only "
        + " and ".join(map(str, far))
        + " go sideways by 5 mm more than the laboratory's isotropic simulation; the others do so"
        f" {slope:.2f} times as far as it says. What is special about these two is not recorded.",
    ]


def _sideways_slope(rows: Sequence[Row]) -> float:
    """Slope of measured against simulated sideways motion, by least squares."""
    measured, simulated = (
        np.array([row[name] for row in rows]) for name in ("sideways_mm", "sideways_mm_simulated")
    )
    return float(measured @ simulated / max(simulated @ simulated, 1e-30))


# --- hypotheses on data, registration and model ---------------------------------------------------


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Hypothesis:
    """Hypothesis on an error of the simulation, or a combination of several.

    Parameters
    ----------
    name : str
    fitted : tuple of str
        Names of fitted parameters; the others have the laboratory's values.
    changes : tuple of callables
        Changes that it applies to the experiment.
    motion : AbstractMotionModel
    together : bool
        Whether the hypothesis is a combination of several.
    verdict : str
        Further evidence for or against it.
    """

    name: str
    fitted: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()
    motion: AbstractMotionModel = field(default_factory=QuasiStatic)
    together: bool = False
    verdict: str = ""


def _both(name: str, fitted: tuple[str, ...], *changes: Change) -> Hypothesis:
    return Hypothesis(name=name, fitted=fitted, changes=changes, together=True)


def scene_of(experiment: Experiment) -> Scene:
    """Scene of an experiment that is known to have one."""
    assert experiment.scene is not None
    return experiment.scene


def _with_body(change: Callable[[Body], Body]) -> Change:
    def changed(experiment: Experiment) -> Experiment:
        scene = scene_of(experiment)
        return replace(experiment, scene=replace(scene, bodies=(change(scene.bodies[0]),)))

    return changed


def _standing(support: Support) -> Change:
    return _with_body(lambda body: replace(body, support=support))


def _leaning(forward: float) -> Change:
    """Shift the centre of pressure along the body's x axis by a linear tilt of the pressure.
    Without inertia, the centre of mass has no other effect."""
    return _with_body(lambda body: replace(body, centre_of_mass=np.array([forward, 0.0])))


def _light(experiment: Experiment) -> Experiment:
    """Set gravity to 9.810 mm/s^2, as in the laboratory's code."""
    return replace(experiment, scene=replace(scene_of(experiment), gravity=9.81e-3))


def _on_path(experiment: Experiment, waypoints: FloatArray) -> Experiment:
    scene = scene_of(experiment)
    pusher = scene.pushers[0]
    drive = PathDrive(waypoints=waypoints, force_limit=pusher.drive.force_limit)
    pusher = replace(pusher, pose=waypoints[0, 1:], drive=drive)
    return replace(experiment, scene=replace(scene, pushers=(pusher,)))


def _waypoints(experiment: Experiment) -> FloatArray:
    drive = scene_of(experiment).pushers[0].drive
    assert isinstance(drive, PathDrive)
    return np.array(drive.waypoints)


def _smoothed(experiment: Experiment) -> Experiment:
    """Move the actuator along the path of the laboratory's filter."""
    path = _waypoints(experiment)
    path[:, 1:3] = next(c for c in experiment.channels if c.name == "actuator-filtered").values
    return _on_path(experiment, path)


def _faster(experiment: Experiment) -> Experiment:
    """Increase the actuator's travel by 10 % in the same time."""
    path = _waypoints(experiment)
    path[:, 1:3] = path[0, 1:3] + 1.1 * (path[:, 1:3] - path[0, 1:3])
    return _on_path(experiment, path)


_FRICTION: Final = ("mu_pusher",)
_PLACE: Final = ("registration_x", "registration_y")
_CENTRE: Final = ("friction_centre_x", "friction_centre_y")
_PLANE: Final = ("anisotropy_xy", "anisotropy_diagonal")
_STANDS: Final = _standing(NET)
_EVEN, _TILTED = _standing(EVEN), _leaning(TILT)

# All hypotheses, from possible faults of the data to those of the model.
HYPOTHESES: Final = (
    Hypothesis(name="as recorded", verdict="the start of this table"),
    Hypothesis(name="inertia", motion=Dynamic(), verdict="slow push: inertia is nothing"),
    Hypothesis(
        name="smoothed actuator path",
        changes=(_smoothed,),
        verdict="runs on after the stall; no difference before it",
    ),
    Hypothesis(
        name="gravity as in the laboratory's code",
        changes=(_light,),
        motion=Dynamic(),
        verdict="a slip of units: the square coasts",
    ),
    Hypothesis(name="speed of the actuator", changes=(_faster,), verdict="10 % faster"),
    Hypothesis(name="friction of the fixels", fitted=("mu_fixel",), verdict="not felt"),
    Hypothesis(
        name="friction of the plane",
        fitted=("mu_support",),
        motion=Dynamic(),
        verdict="not felt but by inertia",
    ),
    Hypothesis(name="tripod radius", fitted=("tripod_radius",)),
    Hypothesis(name="friction of the actuator", fitted=_FRICTION),
    Hypothesis(
        name="registration",
        fitted=_PLACE,
        verdict="the gap to the corner is a steady 0.3 mm: centimetres are not there",
    ),
    Hypothesis(name="registration, turned", fitted=("registration_theta",)),
    Hypothesis(
        name="start pose",
        fitted=("start_x", "start_y", "start_theta"),
        verdict="noise of the pose is 0.05 mm",
    ),
    Hypothesis(name="stickers off the centre", fitted=("outline_x", "outline_y", "outline_theta")),
    Hypothesis(name="even pressure", changes=(_EVEN,)),
    Hypothesis(
        name="push above the plane",
        changes=(_EVEN, _TILTED),
        verdict="a force at a height h moves the centre of pressure by mu h, 13.7 mm at most",
    ),
    Hypothesis(name="centre of friction", fitted=_CENTRE),
    Hypothesis(name="support points anywhere", fitted=CORNERS, changes=(_STANDS,)),
    Hypothesis(
        name="plane with a grain",
        fitted=_PLANE,
        verdict="would show in every trial of the rig",
    ),
    _both("the laboratory's four parameters", ("mu_pusher", "tripod_radius", "mu_fixel")),
    _both("four parameters, registration", ("mu_pusher", "tripod_radius", *_PLACE)),
    _both("even pressure, friction", _FRICTION, _EVEN),
    _both("push above the plane, friction", _FRICTION, _EVEN, _TILTED),
    _both("push above the plane, friction, registration", (*_FRICTION, *_PLACE), _EVEN, _TILTED),
    _both("centre of friction, friction", (*_FRICTION, *_CENTRE), _EVEN),
    _both("support points, friction", (*_FRICTION, *CORNERS), _STANDS),
    _both("plane with a grain, friction", (*_FRICTION, *_PLANE), _EVEN),
)
