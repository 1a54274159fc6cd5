"""Assembly of the ASME paper: a part turned by 90 degrees and pushed into a slot.

Four questions. How often does the last push put the part into a slot of given clearance? Which
pushes bring it from A, with its long side across the slot, into the slot at B? And how much better
are they than pushes that would be best if nothing were unknown, and than those of a random tree
over nominal simulations, as in the earlier work of the same group? What is one look of a camera
worth, with a correction after it?

Unknown are the start, as far as the camera sees it, and the parameters: columns p1* and p2* of
table 1, and sets that explain two identification tests as well as p1*.

Source: ASME 2006 paper on meso-scale manipulation, introduction, table 1 and discussion. It prints
the clearance as "13?m"; the channel of the introduction leaves 158 um.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

import fixel
from fixel.errors import InvalidInput
from fixel.model import (
    Body,
    Ellipsoid,
    Fixel,
    LineDrive,
    Polygon,
    Pusher,
    Scene,
    Support,
    SupportPoints,
)
from fixel.model.goals import BodyTrack, Inside, PoseRegion
from fixel.planning.belief import Belief
from fixel.planning.corrections import CorrectionTable
from fixel.planning.looks import Policy, looks_of, policy_of
from fixel.planning.plan import PlanRuns, simulator_of
from fixel.planning.pushes import FreePushes, scene_of_push
from fixel.planning.search import DRAWS, MarginRequest, PlanSearch, SearchStage, Views
from fixel.planning.success import SuccessProbability
from fixel.replay.base import Row
from fixel.sampling.published import PART_LENGTH, PART_MASS, PART_WIDTH, PROBE_SIDE
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import box, row
from fixel.typing import FloatArray
from fixel.uncertainty.error_terms import ASME, StartError
from reproductions.asme_2006 import (
    CORNERS,
    IDENTIFICATION,
    P1,
    P2,
    PIXEL,
    comparer_of,
    evaluate_sets,
    run_searches,
    simulate_targets,
)
from reproductions.charts.assembly import assembly_figure
from reproductions.nominal_rrt import nominal_rrt
from reproductions.result import Reproduction, RunOptions

UM: Final = 1e-6
CLEARANCES: Final = (158, 130, 80, 40, 20, 13)  # [um]
PLANNED: Final = (158, 130, 13)  # clearances for which the whole assembly is planned [um]
AHEAD: Final = (50, 300)  # from the part to the mouth before the last push [um]
OFFSETS: Final = (0, 20, -20)  # of the probe from the middle of the short side [um]
DEPTH: Final = 800 * UM  # of the part in the slot that counts as assembled [m]
TILTED: Final = 60 * UM  # by which the rear may leave the band: the part may tilt in the slot [m]
SLOT: Final = 2.4e-3  # depth of the slot [m]
SPEED: Final = 1e-4  # [m/s]
WALL_FRICTION: Final = 0.25
CENTRE: Final = 20 * UM  # standard deviation of the pressure centre [m]
# The sizes of the paper as two standard deviations, and as half-widths of a box.
NORMAL: Final = StartError(x=2.5 * UM, y=2.5 * UM, theta=math.radians(0.25), kind="normal")
# Error of the pose that one look sees: that of the paper's camera, and of a better one.
FINE: Final = StartError(x=UM, y=UM, theta=math.radians(0.1), kind="uniform")
CAMERAS: Final = {"look_5um": ASME, "look_1um": FINE}
STARTS: Final = {"normal": NORMAL, "box": ASME}
# Where no blind plan is found, the way ends in front of the mouth, and a look follows.
BEFORE_MOUTH: Final = PoseRegion(
    row(-100 * UM - 0.5 * PART_LENGTH, 0.0, 0.5 * math.pi),
    position=60 * UM, angle=math.radians(2.0), symmetry=2,
)  # fmt: skip
START_A: Final = row(-2.6e-3, -0.4e-3, 0.0)  # the long side lies across the slot
Values = Mapping[str, float]


class Effort(NamedTuple):
    """Sizes of the computations for one assembly."""

    rollouts: int  # of a search
    trees: int  # number of random trees
    looks: int | None  # runs from which looks after a blind plan are stated; None for its own
    stated: int  # runs from which the policy with a look before the mouth is stated
    held: int  # runs in which that policy is carried out


FULL: Final = Effort(8_000, 4, None, 200, 68)
QUICK: Final = Effort(2_000, 1, 8, 8, 4)


class Assembly(NamedTuple):
    """Planned assembly at one clearance."""

    clearance: int  # [um]
    plan: fixel.PushPlan | None  # None where none was found
    row: Row


def run(options: RunOptions) -> Reproduction:
    """Compute the curve of the last push, and plan the whole assembly at three clearances."""
    quick = options.quick
    total = 3 + len(PLANNED)
    options.progress(0, total, "parameter sets as good as p1*")
    sets = near_optimal_sets(2 if quick else 24, 200 if quick else 3000)
    options.progress(1, total, f"{len(sets)} sets; the last push against clearance")
    curve = last_push_curve(16 if quick else 1024)
    options.progress(2, total, "the last push under all sets")
    under_sets = last_push_under_sets(sets, 8 if quick else 256)
    found = []
    for k, clearance in enumerate(PLANNED[:1] if quick else PLANNED):
        options.progress(3 + k, total, f"assembly with a clearance of {clearance} um")
        found.append(assembled(clearance, sets, QUICK if quick else FULL))
    options.progress(total, total, "assembly")
    rows = [own.row for own in found]
    return Reproduction(
        tables={"last_push": curve, "last_push_under_sets": under_sets, "assembly": rows},
        conclusions=_conclusions(curve, under_sets, rows),
        settings={
            "sets": len(sets), "depth_um": DEPTH / UM, "wall_friction": WALL_FRICTION,
            "pressure_centre_um": CENTRE / UM, "start_a": START_A.tolist(), "quick": quick,
        },
        figure=partial(
            assembly_figure, curve, [(own.plan, own.clearance) for own in found if own.plan]
        ),
    )  # fmt: skip


def near_optimal_sets(starts: int, evaluations: int) -> list[Values]:
    """Columns p1* and p2* of table 1, and sets within a pixel of p1* on the two tests."""
    noisy, exact = simulate_targets(seed=1), simulate_targets(seed=None)
    search = run_searches(comparer_of(noisy, IDENTIFICATION), starts, evaluations)
    sets = evaluate_sets(search, noisy, exact)
    good = sets.point[sets.apart <= 1e3 * PIXEL]
    return [as_values(point) for point in (P1, P2, *good.tolist())]


def as_values(point: Sequence[float]) -> Values:
    """Parameters that matter for quasi-static motion, of a column of table 1."""
    return {"mu_pusher": point[0], **dict(zip(CORNERS, point[2:], strict=True))}


# --- the last push ----------------------------------------------------------------------------


def walls(clearance: float) -> tuple[Fixel, ...]:
    """Walls of the slot, which opens at x = 0 towards -x."""
    y = 0.5 * (PART_WIDTH + clearance) + 0.5e-3
    wall = box(SLOT, 1e-3)
    return tuple(
        Fixel(name, wall, pose=row(0.5 * SLOT, side * y, 0.0), friction=WALL_FRICTION)
        for name, side in (("upper", 1.0), ("lower", -1.0))
    )


def in_slot(clearance: float) -> Inside:
    """Goal that the part is in the slot by `DEPTH`: in a band as wide as the slot."""
    half = 0.5 * (PART_WIDTH + clearance)
    back = DEPTH - PART_LENGTH
    band = Polygon(np.array([(back, -half), (SLOT, -half), (SLOT, half), (back, half)]))
    return Inside(band, tolerance=TILTED)


def last_push(clearance: float, ahead: float, offset: float, support: Support) -> Scene:
    """Scene of the push on the short side of the part in front of the slot."""
    x = -ahead - 0.5 * PART_LENGTH
    part = Body(
        "part", box(PART_WIDTH, PART_LENGTH), mass=PART_MASS, pose=row(x, 0.0, 0.5 * math.pi),
        support=support,
    )  # fmt: skip
    clear = 30 * UM
    travel = clear + ahead + DEPTH + 100 * UM
    probe = Pusher(
        "probe", box(PROBE_SIDE, PROBE_SIDE), friction=0.6,
        pose=row(x - 0.5 * (PART_LENGTH + PROBE_SIDE) - clear, offset, 0.0),
        drive=LineDrive(speed=SPEED, travel=travel),
    )  # fmt: skip
    return Scene((part,), (probe,), walls(clearance), duration=travel / SPEED)


def ellipsoid() -> Ellipsoid:
    """Even pressure under the part; friction of the plane does not affect the motion."""
    force = 0.5 * PART_MASS * 9.81
    return Ellipsoid(force=force, torque=485.5 * UM * force)


def last_push_curve(n: int) -> list[Row]:
    """Success of the last push against clearance, with the same scenarios for every clearance."""
    rng = np.random.default_rng(7)
    mu = rng.uniform(0.5, 0.75, n)
    centre = CENTRE * rng.standard_normal((2, n))
    rows: list[Row] = []
    for kind, error in STARTS.items():
        values = {
            **_start_values(error, n),
            "mu_pusher": mu,
            "friction_centre_x": centre[0],
            "friction_centre_y": centre[1],
        }
        for ahead in AHEAD:
            for clearance in CLEARANCES:
                own = [_inserted(clearance, ahead, k, ellipsoid(), values) for k in OFFSETS]
                rows.append(
                    {"start": kind, "mouth_ahead_um": ahead, "clearance_um": clearance,
                     **{f"probe_{k:+d}_um": x for k, x in zip(OFFSETS, own, strict=True)}}
                )  # fmt: skip
    return rows


def last_push_under_sets(sets: Sequence[Values], n: int) -> list[Row]:
    """Success of the last push under every set of parameters, the probe in the middle."""
    start = _start_values(ASME, n)
    rows: list[Row] = []
    for clearance in PLANNED:
        for ahead in AHEAD:
            rates = [
                _inserted(
                    clearance, ahead, 0, SupportPoints(points=_points(own), friction=0.5),
                    {**start, "mu_pusher": np.full(n, own["mu_pusher"])},
                )
                for own in sets
            ]  # fmt: skip
            rows.append(
                {"clearance_um": clearance, "mouth_ahead_um": ahead, "lowest": min(rates),
                 "mean": float(np.mean(rates)), "sets": len(sets)}
            )  # fmt: skip
    return rows


def _points(values: Values) -> FloatArray:
    return np.array([values[name] for name in CORNERS]).reshape(3, 2)


def _start_values(error: StartError, n: int) -> dict[str, FloatArray]:
    columns = error.samples(n, seed=11).T
    return dict(zip(("start_x", "start_y", "start_theta"), columns, strict=True))


def _inserted(
    clearance: int, ahead: int, offset: int, support: Support, values: Mapping[str, FloatArray]
) -> float:
    scene = last_push(clearance * UM, ahead * UM, offset * UM, support)
    ensemble = Ensemble([RolloutCase(scene, np.array([scene.duration]))])
    done = ensemble.simulate(np.zeros(len(values["start_x"]), np.int64), values)
    met = in_slot(clearance * UM).met(scene, BodyTrack.of_ends(done.pose[:, -1]))
    return float((met & done.converged).mean())


# --- the whole assembly -----------------------------------------------------------------------


def assembled(clearance: int, sets: Sequence[Values], effort: Effort) -> Assembly:
    """Plan from A into the slot at B: blind, nominal, by trees, and with one look."""
    part = Body(
        "part", box(PART_WIDTH, PART_LENGTH), mass=PART_MASS, pose=START_A,
        support=SupportPoints(points=_points(sets[0]), friction=0.5),
    )  # fmt: skip
    scene = Scene((part,), (), walls(clearance * UM), duration=1.0)
    choose = FreePushes(
        most=4, tool=box(PROBE_SIDE, PROBE_SIDE), length=(100 * UM, 2600 * UM), clearance=400 * UM,
        speed=SPEED, friction=sets[0]["mu_pusher"],
    )  # fmt: skip
    belief, goal = Belief(parameters=list(sets), start=ASME), in_slot(clearance * UM)
    row: Row = {"clearance_um": clearance, "sets": len(sets), "rollouts": effort.rollouts}
    try:
        plan = fixel.plan(scene, goal, choose, belief, rollouts=effort.rollouts, progress=False)
    except InvalidInput as problem:
        row["found"] = problem.found
        way = replace(choose, most=3)
        plan = fixel.plan(
            scene, BEFORE_MOUTH, way, belief, rollouts=effort.rollouts, progress=False
        )
        return _corrected(clearance, plan, goal, effort, row)
    simulator = simulator_of(plan.scene, goal, choose, belief, None, None, None)
    judge = PlanSearch(simulator=simulator, belief=belief, rollouts=effort.rollouts)
    row |= {"found": "a plan", "pushes": len(plan.pushes), **_rates("blind", plan.success)}
    row["nominal"] = plan.nominal_success.mean
    trees = (nominal_rrt(simulator, k) for k in range(effort.trees))
    grown = [own for own in trees if own is not None]
    draws = judge.fresh_stages[0]
    seen = [SearchStage(DRAWS, effort.looks, 1)] if effort.looks else judge.fresh_stages
    if grown:
        margins = judge.margins(MarginRequest(grown, draws, 0, draws.worlds))
        row["trees"] = (margins >= 0.0).mean(axis=1).tolist()
    for name, camera in CAMERAS.items():
        seeing = replace(judge, views=Views(1, camera))
        first, policy = policy_of(seeing, [choose.numbers(plan.pushes)], None)
        looks, _ = looks_of(policy, seen, 1)
        row |= {**_rates(name, looks.worth[1]), f"{name}_after": len(first)}
        row[f"{name}_before"], row[f"{name}_pushes"] = looks.worth[0].mean, looks.pushes
    return Assembly(clearance, plan, row)


def _corrected(
    clearance: int, way: fixel.PushPlan, goal: Inside, effort: Effort, row: Row
) -> Assembly:
    """State and carry out the policy of one look after the way to the mouth, and one push."""
    simulator = simulator_of(way.scene, goal, way.choose, way.belief, None, None, None)
    table = CorrectionTable.of(simulator, way.belief, way.rollouts, 11)
    row |= {"pushes": len(way.pushes), "before_mouth": way.success.mean}
    planned, plan = simulator.planned(way.choose.numbers(way.pushes)[None]), way
    sets = len(way.belief.parameters)
    for name, camera in CAMERAS.items():
        policy = Policy(
            simulator=simulator, belief=way.belief, planned=planned, table=table,
            views=Views(1, camera),
        )  # fmt: skip
        looks, drawn = looks_of(policy, [SearchStage(DRAWS, effort.stated, 1)], 1)
        rngs = np.random.default_rng(13).spawn(effort.held)
        held = [carried_out(policy, k % sets, rng) for k, rng in enumerate(rngs)]
        row |= {**_rates(name, looks.worth[1]), f"{name}_after": len(way.pushes)}
        row |= {f"{name}_held": sum(held) / len(held), f"{name}_pushes": looks.pushes}
        missed = tuple("" if own >= 0.0 else "missed" for own in looks.walk.margin[1])
        row["held_runs"] = len(held)
        runs = PlanRuns(drawn, looks.walk.margin[1], looks.walk.pose, missed)
        plan = replace(way, runs=runs, success=looks.worth[1])
    return Assembly(clearance, plan, row)


def carried_out(policy: Policy, k: int, rng: np.random.Generator) -> bool:
    """Carry out a policy of one look under the parameter set k, by single simulations."""
    simulator, camera = policy.simulator, policy.views.camera
    world, scene = policy.belief.parameters[k], simulator.scene
    pose = START_A + rng.uniform(-1.0, 1.0, 3) * ASME.size
    for path in policy.planned.path[0]:
        pose = _pushed(scene, pose, path, world)
    seen = pose + rng.uniform(-1.0, 1.0, 3) * camera.size
    chosen = policy.next(seen)
    if chosen.row[0] >= 0:
        path = simulator.choice.motions(scene, chosen.numbers, seen[None]).path[0]
        pose = _pushed(scene, pose, path, world)
    return bool(simulator.goal.met(scene, BodyTrack.of_ends(pose))[0])


def _pushed(scene: Scene, pose: FloatArray, path: FloatArray, world: Values) -> FloatArray:
    push = scene_of_push(scene, pose, path)
    return np.asarray(fixel.simulate(push, world, motion="quasistatic")["part"].pose[-1])


def _rates(name: str, success: SuccessProbability) -> Row:
    return {name: success.mean, f"{name}_low": success.low, f"{name}_worst": success.worst}


def _conclusions(curve: Sequence[Row], under_sets: Sequence[Row], rows: Sequence[Row]) -> list[str]:
    sentences = []
    for kind in STARTS:
        own = [
            f"{one['clearance_um']} um {one['probe_+0_um']:.2f}"
            for one in curve
            if one["start"] == kind and one["mouth_ahead_um"] == AHEAD[1]
        ]
        sentences.append(
            f"Last push, mouth {AHEAD[1]} um ahead, start errors {kind}: {', '.join(own)}."
        )
    wide = [one["lowest"] for one in under_sets if one["clearance_um"] >= 130]
    sentences.append(
        f"At 130 and 158 um the last push succeeds in {min(wide):.3f} or more under every one of"
        f" {under_sets[0]['sets']} parameter sets."
    )
    for one in rows:
        name = f"A to B at {one['clearance_um']} um"
        if one["found"] != "a plan":
            looks = ", ".join(
                f"{own.removeprefix('look_')} {one[own]:.3f} ({one[f'{own}_low']:.3f});"
                f" held {one[f'{own}_held']:.3f} of {one['held_runs']}"
                for own in CAMERAS
            )
            sentences.append(
                f"{name}: no blind plan; {one['found']}. {one['pushes']} pushes to the mouth, one"
                f" look and one push: {looks}."
            )
            continue
        trees = one.get("trees", [])
        tree = f"{np.mean(trees):.3f} (mean of {len(trees)})" if trees else "not found"
        sentences.append(
            f"{name}: {one['pushes']} pushes blind {one['blind']:.3f} (worst sets"
            f" {one['blind_worst']:.3f}), nominal {one['nominal']:.3f}, tree over nominal"
            f" simulations {tree}; one look with a camera of 5 um {one['look_5um']:.3f}, of 1 um"
            f" {one['look_1um']:.3f}."
        )
    return sentences
