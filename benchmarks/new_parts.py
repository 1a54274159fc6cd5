"""Learning curves of parts that were never pushed, on an imperfect simulated laboratory.

``python -m benchmarks new-parts`` leaves every part out, predicts its pushes after 0 to 20 of its
own, chosen or at random, and compares errors and bounds. The laboratory differs from the model that
is fitted: parts stand on even pressure, tripods or points with random loads, on a plate of uneven
friction; starts are off by 0.3 mm and 0.3 deg, and the camera has noise.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.figures import Figure, Size
from benchmarks.report import RESULTS
from fixel.domain.error_bound import CAUTIOUS, TYPICAL
from fixel.model import (
    Body,
    Experiment,
    LineDrive,
    PlannedExperiment,
    Polygon,
    Scene,
    Support,
    Tripod,
    UniformPressure,
)
from fixel.parts.fit import choose_pushes, learned_prior, slopes
from fixel.parts.left_out import halves, leave_parts_out
from fixel.parts.model import PartModel
from fixel.parts.next_pushes import NextPushes, push_candidates
from fixel.testbed.simulated import SimulatedTestbed
from fixel.workflows.parts import part_model

SEED: Final = 17001
PARTS, PUSHES = 9, 60
LADDER: Final = (0, 1, 2, 3, 5, 10, 20)
START_M, START_RAD = 3e-4, math.radians(0.3)
RUN_UP: Final = 1.5e-3  # of the pusher before the nominal contact, so that no start overlaps it [m]
ROWS: Final = RESULTS / "new-parts.csv"


def laboratory(parts: int, pushes: int, seed: int = SEED) -> list[Experiment]:
    """Pushes of parts of several outlines, each with its own kind of support."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(parts):
        outline = _outline(rng, k)
        truth, bench = _support(rng, k, seed)
        body = Body("part", outline, mass=0.8, support=UniformPressure(friction=0.25))
        scenes = push_candidates(body, travel=0.05, contacts=max(4, pushes // 2))
        chosen = rng.permutation(len(scenes))[:pushes].tolist()
        planned = [
            PlannedExperiment(
                name=f"part-{k + 1}-{j + 1:02d}",
                scene=_as_made(scenes[which], truth, rng),
                conditions={"part": f"part-{k + 1}", "surface": "bench"},
            )
            for j, which in enumerate(chosen)
        ]
        for own, which in zip(bench.run(planned, threads=1), chosen, strict=True):
            found.append(replace(own, scene=_with_run_up(scenes[which])))
    return found


def _outline(rng: np.random.Generator, k: int) -> Polygon:
    """Rectangles, triangles, hexagons and ellipses in turn, of 80 to 120 mm."""
    a, b = rng.uniform(0.04, 0.06, 2)
    n, shift = ((4, 0.25), (3, 0.25), (6, 0.0), (24, 0.0))[k % 4]
    turn = 2.0 * np.pi * (np.arange(n) + shift * 2.0) / n
    return Polygon(np.column_stack((a * np.cos(turn), b * np.sin(turn))) * (1.2 if n < 6 else 1.0))


def _support(rng: np.random.Generator, k: int, seed: int) -> tuple[Support, SimulatedTestbed]:
    """True support and laboratory: even pressure, a tripod, or points with random loads."""
    bench = SimulatedTestbed(seed=seed + k, support_cells=0, centre_of_pressure=(0.0, 0.0))
    if k % 3 == 0:
        return UniformPressure(friction=0.25), bench
    if k % 3 == 1:
        radius, angle = float(rng.uniform(0.015, 0.025)), float(rng.uniform(0.0, 2.0))
        return Tripod(radius=radius, friction=0.25, angle=angle), bench
    return UniformPressure(friction=0.25), replace(bench, support_cells=16, unevenness=0.6)


def _with_run_up(scene: Scene) -> Scene:
    (tip,) = scene.pushers
    drive = tip.drive
    assert isinstance(drive, LineDrive)
    back = tip.pose - RUN_UP * np.array([*drive.direction, 0.0])
    further = replace(drive, travel=drive.travel + RUN_UP)
    duration = scene.duration + RUN_UP / drive.speed
    return replace(scene, pushers=(replace(tip, pose=back, drive=further),), duration=duration)


def _as_made(scene: Scene, support: Support, rng: np.random.Generator) -> Scene:
    """Scene with the true support, at a start that is slightly off."""
    (body,) = scene.bodies
    pose = body.pose + rng.normal(size=3) * (START_M, START_M, START_RAD)
    return replace(_with_run_up(scene), bodies=(replace(body, pose=pose, support=support),))


def curves(model: PartModel, ladder: tuple[int, ...]) -> Iterator[dict[str, float | str]]:
    """Mean errors and bounds of parts that were left out, after k of their pushes."""
    for way in ("random", "chosen"):
        for k in ladder:
            if way == "chosen" and not k:
                continue
            left = leave_parts_out(
                model._groups, model.fits, model.share, k, chosen=way == "chosen", seed=model.seed
            )
            if left.errors.size:
                yield {"choice": way, "pushes": float(k), **_row(replace(model, left_out=left))}


def _row(model: PartModel) -> dict[str, float]:
    left = model.left_out
    group = np.array(left.group)
    names = dict.fromkeys(left.group)
    means = np.array([_mean(left.errors[group == name]) for name in names])
    typical, cautious = (
        np.mean([own[rule].bounds(left.features).mean() for own in model._bounds[:1]])
        if model._bounds[0]
        else math.nan
        for rule in (TYPICAL, CAUTIOUS)
    )
    covered = model.coverage.get("position", (math.nan, math.nan))
    return {
        "position_mm": 1e3 * float(means[:, 0].mean()),
        "angle_deg": math.degrees(float(means[:, 1].mean())),
        "typical_mm": 1e3 * float(typical),
        "cautious_mm": 1e3 * float(cautious),
        "covered_typical": covered[0],
        "covered_cautious": covered[1],
        "worst_part_mm": 1e3 * float(means[:, 0].max()),
    }


def _mean(errors: np.ndarray) -> np.ndarray:
    return np.asarray(errors[np.isfinite(errors).all(axis=1)].mean(axis=0))


def expected(model: PartModel, ladder: tuple[int, ...]) -> dict[int, float]:
    """Mean expected ratio of the bound after k chosen pushes to that before, over parts."""
    rows = []
    for (surface, part), group in model._groups.items():
        prior = learned_prior([o for o in model.fits if o.part != part], surface, model.share)
        pool = np.sort(halves(len(group), model.seed)[0])
        table = slopes(group, pool, prior)
        _, variance = choose_pushes(table, table, max(ladder))
        rows.append(ratios_of(variance, model))
    n = min(map(len, rows))
    mean = np.mean([own[:n] for own in rows], axis=0)
    return {k: float(mean[k - 1]) for k in ladder if 0 < k <= n}


def ratios_of(variance: np.ndarray, model: PartModel) -> np.ndarray:
    """Expected ratios of `NextPushes` for a variance after each push."""
    k = len(variance) - 1
    nothing = np.zeros((k, 2))
    return NextPushes(
        order=tuple(range(k)), names=("",) * k, start=nothing, end=nothing, outline=nothing,
        radius=0.0, variance=variance, error=model.typical_error, misfit=model.misfit,
        position=np.ones(2), angle=np.ones(2), bounded=(1, 1), candidates=k, idle=0, pushes=0,
    ).shrinking  # fmt: skip


def run(size: Size) -> list[Figure]:
    """Learning curves, and how honest the expected bounds are."""
    full = size.rollouts >= 500
    experiments = laboratory(PARTS, PUSHES) if full else laboratory(4, 12)
    ladder = LADDER if full else (0, 3)
    model = part_model(experiments, progress=False, threads=1)
    rows = list(curves(model, ladder))
    if full:
        _write(ROWS, rows)
    ratio = expected(model, ladder)
    at = {(row["choice"], row["pushes"]): row for row in rows}
    start = at["random", 0.0]
    figures = []
    for (way, k), row in at.items():
        name = f"new parts, {k:.0f} pushes{f' {way}' if k else ''}"
        for what, unit in (("position", "mm"), ("angle", "deg"), ("typical", "mm")):
            figures.append(Figure(f"{name}, {what}", unit, (float(row[f"{what}_{unit}"]),)))
    for k, share in ratio.items():
        own = at.get(("chosen", float(k)))
        if own is None:
            continue
        name = f"new parts, {k} chosen pushes"
        figures.append(Figure(f"{name}, expected share of the bound", "-", (share,)))
        for what in ("typical_mm", "position_mm"):
            realised = float(own[what]) / float(start[what])
            figures.append(Figure(f"{name}, realised share of {what[:-3]}", "-", (realised,)))
    return [one for one in figures if math.isfinite(one.median)]


def _write(path: Path, rows: list[dict[str, float | str]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(
            {n: x if isinstance(x, str) else f"{x:.4g}" for n, x in row.items()} for row in rows
        )
