"""Tour from a table of pushes to a plan that works in another simulator."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from math import ceil, degrees, nan
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from fixel import model
from fixel.database.project import Project
from fixel.drawing.animation import animate_simulation, film_ending
from fixel.io.atomic import write_whole, written_whole
from fixel.parts.next_pushes import push_candidates
from fixel.simulation import simulate
from fixel.testbed.simulated import TRUTH, SimulatedTestbed
from fixel.typing import Notify
from fixel.units import deg, mm
from fixel.workflows.capabilities import call
from fixel.workflows.demo.laboratory_demo import own_folder
from fixel.workflows.experiments import read_experiments
from fixel.workflows.report.write import next_command

if TYPE_CHECKING:
    from fixel.planning.plan import PushPlan
    from fixel.workflows.calibration.calibration import Calibration

FIT: Final = 24  # pushes that are calibrated; the other 60 are held out
CONTACTS: Final = 28  # places of pushes around the part, each with three directions
TRIALS, FILMED = 100, 12  # runs in the other simulator, and those of them in the film
TIP, SPEED = 5 * mm, 10 * mm  # slow enough for quasi-static motion [m/s]
# Noise of the camera [m, m, rad], of the recorded tip [m] and of the clock of the table [s].
CAMERA, TIP_NOISE, JITTER = (0.2 * mm, 0.2 * mm, 0.15 * deg), 0.01 * mm, 2e-3
TABLE, SCENE = "pushes.csv", "scene.yaml"
YOURS: Final = "my-pushes"  # project in the commands to repeat
HEAD: Final = "push,use,time_s,x_mm,y_mm,theta_deg,pusher_x_mm,pusher_y_mm"
ENGINE: Final = "pymunk:inertia_factor=10,step=0.002"  # its usual remedy, see docs/decisions/0040
CLOSE: Final = 0.05  # largest difference of stated and true success

# The tool of the plan is wider than the tip that was recorded, and of the same material.
GOAL: Final = """\
fixel: 1
scene: scene.yaml
goal:
  pose: {pose_mm_deg: [40, 10, 15], position_mm: 5, angle_deg: 5}
choose:
  free:
    tool: {polygon_mm: [[-5, -20], [5, -20], [5, 20], [-5, 20]]}
    clearance_mm: 5
    retract_mm: 5
    speed: 0.01
belief:
  calibration: 1
  friction_scatter: 0.2    # between runs, seven times that of the laboratory
  start: {x_mm: 1, y_mm: 1, theta_deg: 1, kind: uniform}
"""


class DemoClaim(NamedTuple):
    """Statement of fixel, and the truth."""

    what: str
    stated: str
    truth: str
    right: bool


class DemoStep(NamedTuple):
    """Step of the tour that is done."""

    title: str
    lines: tuple[str, ...]
    repeat: tuple[str, ...] = ()  # commands that do the same, or lines of Python
    claims: tuple[DemoClaim, ...] = ()


class Laboratory(NamedTuple):
    """Simulated laboratory: its pushes, and the true values."""

    experiments: list[model.Experiment]
    mu_pusher: float  # mean of the calibrated pushes [-]
    tripod_radius: float  # [m]


def tell_story(folder: Path, seed: int = 1, notify: Notify | None = None) -> Iterator[DemoStep]:
    """Calibrate a table of pushes, predict others, plan, check the plan, and write a report.

    The seed is that of the laboratory: its true values, pushes and noise. `notify` is called with a
    sentence before each step.
    """
    tell = notify or (lambda _: None)
    own = own_folder(folder / f"laboratory-{seed}", tell)
    goal, lab = own / "goal.yaml", own / "project"
    at = f"--project {quote(str(lab))}"
    tell(f"performing {3 * CONTACTS} pushes in a simulated laboratory")
    truth = laboratory(seed)
    yield _recorded(own, truth, seed)

    tell("reading the table")
    project = Project(lab) if (lab / "fixel.yaml").is_file() else Project.create(lab)
    yield _imported(project, own, len(truth.experiments))

    tell("calibrating friction and support")
    found = call(
        project, "calibrate", mode="joint", motion="quasistatic", where=("use=fit",),
        fit=("mu_pusher=0:1", "tripod_radius_mm=10:60"),
    )  # fmt: skip
    fit, number = found[-1], found.ids[-1]
    command = (
        "fixel calibrate --mode joint --motion quasistatic --fit mu_pusher=0:1"
        f" --fit tripod_radius_mm=10:60 --where use=fit {at}"
    )
    summary, claims = tuple(str(fit).splitlines()), tuple(_claims(fit, truth))
    yield DemoStep("What the pushes determine, and the values", summary, (command,), claims)

    tell("bounding the error of new pushes")
    bound = call(project, "error-bound", calibration=number, where=("use=fit",)).bound
    yield _predicted(bound, fit, project.experiments("use=test"), at)

    tell("planning a push despite uncertain friction and start")
    write_whole(goal, GOAL.replace("calibration: 1", f"calibration: {number}"))
    plan = call(project, "plan", goal=str(goal), rollouts=10_000).found.plan
    tell(f"carrying it out {TRIALS} times in pymunk")
    yield _carried_out(plan, goal, seed, at)

    tell("filming the plan and its prediction")
    film(plan, path := own / f"plan{film_ending()}", seed)
    shown = f"{path}  filled: the prediction; outlines: {FILMED} runs in pymunk"
    yield DemoStep("Film", (shown,), ('plan.animate("plan.gif")',))

    tell("writing the report")
    report = project.report(own / "report", calibration=number, command=f"fixel report {at}")
    yield DemoStep("Report", (next_command(report),), (f"fixel report {at}",))


# --- the laboratory -------------------------------------------------------------------------------


def first_guess(radius: float = 30 * mm) -> model.Scene:
    """Return the part, with a tip that waits at its side."""
    support = model.Tripod(radius=radius, friction=0.25)
    part = model.Body("part", model.Polygon.rectangle(100 * mm, 80 * mm), mass=0.5, support=support)
    drive = model.LineDrive((1.0, 0.0), speed=SPEED)
    tip = model.Pusher("tip", model.Disk(TIP), pose=(-0.2, 0.0, 0.0), friction=0.3, drive=drive)
    return model.Scene(part, tip, duration=3.0)


def laboratory(seed: int) -> Laboratory:
    """Push a part from all sides; the seed decides the true friction and support, too."""
    rng = np.random.default_rng(seed)
    friction, radius = rng.uniform(0.15, 0.4), rng.uniform(26 * mm, 42 * mm)
    scenes = push_candidates(
        first_guess(radius).bodies[0],
        radius=TIP, travel=90 * mm, speed=SPEED, friction=friction, contacts=CONTACTS,
    )  # fmt: skip
    planned = []
    for k, j in enumerate(rng.permutation(len(scenes)), 1):
        scene = replace(scenes[j], duration=rng.uniform(40 * mm, 90 * mm) / SPEED)
        planned.append(model.PlannedExperiment(name=f"{k:02d}", scene=scene))
    testbed = replace(
        SimulatedTestbed.ideal(seed), pusher_spread=0.03, support_spread=0.05, speed_spread=0.01,
        ripple=0.05, frame_rate=10.0, dropped_frames=0.01,
    )  # fmt: skip
    done = list(testbed.run(planned))
    ratios = [float(own.conditions[f"{TRUTH}pusher_friction_ratio"]) for own in done[:FIT]]
    return Laboratory(done, friction * float(np.mean(ratios)), radius)


def write_table(path: Path, experiments: list[model.Experiment], seed: int) -> None:
    """Write poses as a camera, a robot and a clock record them, as CSV."""
    rng = np.random.default_rng([seed, 1])
    with written_whole(path) as temporary, temporary.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(HEAD.split(","))
        for k, own in enumerate(experiments):
            assert own.pusher is not None
            n = len(own.trajectory.time)
            time = own.trajectory.time + np.append(0.0, rng.normal(0.0, JITTER, n - 1))
            pose = own.trajectory.pose + rng.normal(size=(n, 3)) * CAMERA
            tip = own.pusher.pose[:, :2] + rng.normal(size=(n, 2)) * TIP_NOISE
            use = "fit" if k < FIT else "test"
            for t, *numbers in np.column_stack((time, pose / (mm, mm, deg), tip / mm)).tolist():
                rows.writerow((own.name, use, f"{t:.3f}", *(f"{x:.3f}" for x in numbers)))


# --- claims ---------------------------------------------------------------------------------------


def _recorded(own: Path, truth: Laboratory, seed: int) -> DemoStep:
    own.mkdir(parents=True, exist_ok=True)
    write_table(own / TABLE, truth.experiments, seed)
    first_guess().save(own / SCENE)
    lines = (
        f"{own / TABLE}  simulated poses, with the noise of a camera and a robot",
        f"{own / SCENE}  outlines, and first guesses of friction and support",
    )
    return DemoStep("A table of pushes, and a scene", lines)


def _imported(project: Project, own: Path, true: int) -> DemoStep:
    table, scene = own / TABLE, own / SCENE
    options = {"split_by": "push", "simulated_by": "fixel demo"}
    project.add(read_experiments(table, scene=scene, **options))  # type: ignore[arg-type]
    n = len(project.experiments())
    commands = (  # the project of the demo has these pushes
        f"fixel new {YOURS}",
        f"fixel import {quote(str(table))} --scene {quote(str(scene))} --project {YOURS}"
        + "".join(f" --option {name}={quote(value)}" for name, value in options.items()),
    )
    lines = (f"The header names the units: {HEAD}", "Leave out simulated_by for measured pushes.")
    claim = DemoClaim("pushes", str(n), str(true), n == true)
    return DemoStep("Import", lines, commands, (claim,))


def _claims(fit: Calibration, truth: Laboratory) -> Iterator[DemoClaim]:
    for name, scale, unit in (("mu_pusher", 1.0, ""), ("tripod_radius", 1e3, " mm")):
        own, true = fit.estimates[name], getattr(truth, name)
        low, high = (nan if end is None else end for end in (own.low, own.high))
        right = own.verdict == "identified" and low <= true <= high
        stated = f"{own.verdict}, {scale * low:.4g} to {scale * high:.4g}{unit}"
        yield DemoClaim(name, stated, f"{scale * true:.4g}{unit}", right)


def _predicted(bound: Any, fit: Calibration, pushes: Any, at: str) -> DemoStep:
    """Compare the ends of held-out pushes with their bounds."""
    errors, bounds = [], []
    for push in pushes:
        own = bound.at(push.scene)
        if own.position is None:
            continue
        run = simulate(push.scene, model.Parameters(fit.values_for()), motion=fit.motion)
        off = model.pose_error(run.pose["part"][-1:], push.trajectory.pose[-1:])
        errors.append([abs(float(error[0])) for error in off])
        bounds.append((own.position, own.angle))
    n, (low, high) = len(bounds), expected(bound.level, len(bound.keys), len(bounds))
    position, angle = np.median(bounds, axis=0).tolist()
    lines = (
        f"90 % of new pushes end within {1e3 * position:.2g} mm, and 90 % within"
        f" {degrees(angle):.2g} deg; {n} of {len(pushes)} held-out pushes resemble recorded ones.",
        f"Right if {low} to {high} of {n} are inside, the range of chance for bounds from {FIT}.",
    )
    inside = np.less_equal(errors, bounds).sum(axis=0).tolist()
    claims = (
        DemoClaim(f"{name} inside", f"90 % of {n}", f"{k}", low <= k <= high)
        for name, k in zip(("positions", "angles"), inside, strict=True)
    )
    repeat = (f"fixel error-bound --where use=fit {at}",
              "fixel.error_bound(pushes, fit).at(push.scene)")  # fmt: skip
    return DemoStep("Pushes that the calibration has not seen", lines, repeat, tuple(claims))


def expected(level: float, n: int, new: int) -> tuple[int, int]:
    """Return the 95 % range of the number of new pushes inside a conformal bound from n others.

    The share inside is beta distributed over the pushes from which a bound is made (Vovk 2012).
    """
    from scipy.stats import betabinom

    rank = min(n, ceil(level * (n + 1)))
    low, high = betabinom(new, rank, n + 1 - rank).interval(0.95)
    return int(low), int(high)


def _carried_out(plan: PushPlan, goal: Path, seed: int, at: str) -> DemoStep:
    held, stated = plan.success_in(ENGINE, TRIALS, seed=seed), plan.success.mean
    lines = (
        f"{goal}  40 mm ahead, 10 mm aside and turned by 15 deg, within 5 mm and 5 deg",
        "Between runs, friction scatters by 20 %, and the start by 1 mm and 1 deg.",
        f"The push that is best without scatter succeeds in {100 * plan.nominal_success.mean:.0f}"
        f" %, this one in {100 * stated:.0f} %.",
        f"Right if the 95 % interval of {TRIALS} runs comes within {100 * CLOSE:.0f} points.",
    )
    commands = (f"fixel plan {quote(str(goal))} --rollouts 10000 {at}",
                f"fixel plan run {quote(str(goal.with_suffix('.plan')))} -n {TRIALS}"
                f" --engine {ENGINE}")  # fmt: skip
    true = f"{100 * held.value:.0f} % ({100 * held.low:.0f} to {100 * held.high:.0f}) in pymunk"
    right = held.low - CLOSE <= stated <= held.high + CLOSE
    claim = DemoClaim("success of the plan", f"{100 * stated:.0f} %", true, right)
    return DemoStep("A push that works although friction is uncertain", lines, commands, (claim,))


def film(plan: PushPlan, path: Path, seed: int) -> None:
    """Film the predicted motion, with runs in the other simulator as outlines."""
    drawn, scene = plan.draw(FILMED, seed), plan.scenes[0]
    part, others = scene.bodies[0], []
    for k in range(FILMED):
        moved = replace(scene, bodies=(replace(part, pose=part.pose + drawn.start[k]),))
        values = {name: float(column[k]) for name, column in drawn.values.items()}
        others.append(simulate(moved, model.Parameters(values), motion=ENGINE))
    animate_simulation(plan.as_planned()[0], path, others=others)
