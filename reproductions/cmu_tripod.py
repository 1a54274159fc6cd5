"""CMU's pushes on machined supports: identification of the support points from pushes alone.

Source: Zhou, Paolini, Bagnell & Mason (2016), A convex polynomial force-motion model for planar
sliding, section V. The supports were machined, so the true points are known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.study import box_of
from fixel.model import SupportPoints, UniformPressure
from fixel.model.space import ParameterSpace, Unknown
from fixel.model.support import triangle_shares
from fixel.replay.base import Row
from fixel.typing import FloatArray
from reproductions.charts.pictures import supports_figure
from reproductions.result import Reproduction, RunOptions
from reproductions.support_features import support_features
from reproductions.tripod_pushes import (
    FORCE_NOISE,
    POSE_NOISE,
    STEP,
    SURFACES,
    Forces,
    SupportFit,
    TripodPush,
    best_friction,
    comparer_of,
    fit_points,
    machined,
    outline_of,
    read_pushes,
    sliding_forces,
    support_of,
)


def run(options: RunOptions) -> Reproduction:
    """Estimate support points from pushes, friction from forces, and predict other pushes.

    With `quick`, it uses two starts and a third of the pushes.
    """
    pushes = read_pushes(options.folder, every=3 if options.quick else 1)
    supports = sorted({support_of(p) for p in pushes} - {"patch"})
    parts, done = 2 * len(supports) + 2, 0
    found: list[Row] = []
    drawn: dict[str, tuple[FloatArray, ...]] = {}
    search = LeastSquares(
        loss="soft_l1",
        width=2.0,
        starts=2 if options.quick else 4,
        most_iterations=15,
        tolerance=1e-4,
    )
    for support in supports:
        own = [p for p in pushes if support_of(p) == support]
        fits = {}
        for forces in (False, True):
            fits[forces] = fit_points(own, search, forces=forces)
            known = fit_points(own, search, forces=forces, known=True)
            row = _distance_row(support, own, fits[forces], known, forces)
            if not forces:
                row["distance_mm_rms_attainable"] = attainable_mm(own, known, search)
            found.append(row)
            done += 1
            options.progress(done, parts, f"{support}, {'poses and forces' if forces else 'poses'}")
        drawn[support] = machined(own[0]), fits[False].points, fits[True].points
    friction = surface_friction(pushes)
    options.progress(done + 1, parts, "friction of the surfaces")
    transfer = [row for support in supports for row in transfer_rows(pushes, support, search)]
    options.progress(parts, parts, "prediction across supports")
    return Reproduction(
        tables={"supports": found, "friction": friction, "transfer": transfer},
        conclusions=_conclusions(found, friction, transfer),
        settings={
            "pushes": len(pushes),
            "position_noise_mm": 1.0,
            "angle_noise_deg": 1.0,
            "force_noise_n": FORCE_NOISE,
            "step_s": STEP,
            "starts": search.starts,
            "quick": options.quick,
        },
        figure=partial(supports_figure, outline_of(pushes[0]), drawn),
    )


def attainable_mm(pushes: Sequence[TripodPush], known: SupportFit, options: LeastSquares) -> float:
    """Root mean square distance [mm] of fitted from machined points, for pushes simulated on the
    machined points with the stated noise: the best accuracy that the data permit."""
    space = shared_space()
    n = len(pushes)
    point = np.append(known.values["mu_pusher"], np.zeros(2))
    difference, _, _ = comparer_of(pushes, space).differences(np.arange(n), np.tile(point, (n, 1)))
    noise = np.random.default_rng(0).normal(size=(n, 3)) * POSE_NOISE
    made = []
    for push, off, error in zip(pushes, difference, noise, strict=True):
        end = push.target.pose[-1] + off[-1] + error
        target = push.target._replace(pose=np.tile(end, (len(push.target.pose), 1)))
        made.append(push._replace(target=target))
    apart = fit_points(made, options, forces=False).points - machined(pushes[0])
    return float(1e3 * np.sqrt(np.mean(np.sum(apart**2, axis=1))))


def _distance_row(
    support: str, pushes: Sequence[TripodPush], found: SupportFit, known: SupportFit, forces: bool
) -> Row:
    truth = machined(pushes[0])
    share = triangle_shares(truth)
    apart = np.hypot(*(found.points - truth).T) * 1e3
    loads = np.maximum(triangle_shares(np.array([truth, found.points])), 0.0)
    features = support_features(np.array([truth, found.points]), loads)
    return {
        "support": support,
        "from": "poses and forces" if forces else "poses",
        "pushes": len(pushes),
        "distance_mm_each": np.round(apart, 1).tolist(),
        "distance_mm_rms": float(np.sqrt(np.mean(apart**2))),
        "distance_mm_load_weighted": float(np.sqrt(np.sum(share * apart**2))),
        "mean_radius_mm": float(features.mean_radius[1] * 1e3),
        "mean_radius_mm_machined": float(features.mean_radius[0] * 1e3),
        "principal_radii_mm": np.round(features.radii[1] * 1e3, 1).tolist(),
        "principal_radii_mm_machined": np.round(features.radii[0] * 1e3, 1).tolist(),
        "mu_pusher": found.values["mu_pusher"],
        **{f"mu_{name}": value for name, value in found.friction.items()},
        "points_mm": np.round(found.points * 1e3, 1).tolist(),
        "deviance": found.deviance,
        "deviance_machined": known.deviance,
        "mu_pusher_machined": known.values["mu_pusher"],
    }


# --- friction from forces -----------------------------------------------------------------------


def surface_friction(pushes: Sequence[TripodPush], mu_pusher: float = 0.5) -> list[Row]:
    """Rows with the friction of each surface, from forces on machined points and of the authors."""
    space = ParameterSpace(
        unknowns=(Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=mu_pusher),)
    )
    on_points = [p for p in pushes if support_of(p) != "patch"]
    comparer = comparer_of(on_points, space)
    n = len(on_points)
    difference, _, _ = comparer.differences(np.arange(n), np.full((n, 1), mu_pusher))
    points = np.array([machined(p) for p in on_points])
    forces = sliding_forces(on_points, np.arange(n), difference, points)
    surface = np.array([str(p.target.conditions["surface"]) for p in on_points])
    support = np.array([support_of(p) for p in on_points])
    rows = []
    for name in SURFACES:
        for kind in (*sorted(set(support.tolist())), "all"):
            own = (surface == name) & ((support == kind) | (kind == "all"))
            if own.any():
                rows.append(_friction_row(name, kind, on_points, own, forces))
    return rows


def _friction_row(
    name: str, kind: str, pushes: Sequence[TripodPush], own: np.ndarray, forces: Forces
) -> Row:
    part = Forces(forces.measured[own], forces.unit[own])
    first = pushes[int(np.flatnonzero(own)[0])].target.case.scene.bodies[0].support
    assert isinstance(first, SupportPoints)
    cross = part.unit[:, 0] * part.measured[:, 1] - part.unit[:, 1] * part.measured[:, 0]
    angle = np.degrees(np.arctan2(cross, np.sum(part.unit * part.measured, axis=1)))
    size = np.hypot(*part.unit.T)
    ratio = np.hypot(*part.measured.T)[size > 0.0] / size[size > 0.0]
    return {
        "surface": name,
        "support": kind,
        "pushes": int(own.sum()),
        "mu": best_friction(part),
        "mu_median": float(np.median(ratio)),
        "mu_standard_error": float(1.25 * ratio.std() / math.sqrt(len(ratio))),
        "mu_authors": float(first.friction),
        "direction_deg_median": float(np.median(np.abs(angle))),
    }


# --- transfer to other supports -----------------------------------------------------------------


def shared_space() -> ParameterSpace:
    """Parameter space independent of the support: finger friction and registration of the robot."""
    return ParameterSpace(
        unknowns=(
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.5),
            Unknown(name="registration_x", low=-3e-3, high=3e-3, nominal=0.0, scale=5e-4),
            Unknown(name="registration_y", low=-3e-3, high=3e-3, nominal=0.0, scale=5e-4),
        )
    )


def transfer_rows(pushes: Sequence[TripodPush], support: str, options: LeastSquares) -> list[Row]:
    """Errors on half of the pushes on one support, with parameters learned from other supports."""
    others = [p for p in pushes if support_of(p) not in (support, "patch")]
    own = [p for p in pushes if support_of(p) == support]
    train, test = own[::2], own[1::2]
    point = fit_shared(others, options)
    nominal = shared_space().nominal
    points = fit_points(train, options, forces=True).points
    even = [_standing(p, UniformPressure(friction=0.3)) for p in test]
    found = [_standing(p, SupportPoints(points=points, friction=0.3)) for p in test]
    cases = (
        ("even pressure", "nothing", even, nominal),
        ("even pressure", "other supports", even, point),
        ("fitted on its other half", "nothing", found, nominal),
        ("fitted on its other half", "other supports", found, point),
        ("machined", "nothing", test, nominal),
        ("machined", "other supports", test, point),
    )
    return [
        {
            "support": support,
            "points": which,
            "finger_and_registration": learnt,
            "pushes": len(test),
            "mu_pusher": float(values[0]),
            "registration_mm": np.round(1e3 * values[1:], 2).tolist(),
            **_errors(some, values),
        }
        for which, learnt, some, values in cases
    ]


def fit_shared(pushes: Sequence[TripodPush], options: LeastSquares) -> FloatArray:
    space = shared_space()
    comparer = comparer_of(pushes, space)
    n = len(pushes)

    def residuals(trials: FloatArray) -> FloatArray:
        which = np.tile(np.arange(n), len(trials))
        difference, good, _ = comparer.differences(which, np.repeat(trials, n, axis=0))
        found = difference[:, -1] / POSE_NOISE
        found[~good] = np.inf
        return np.asarray(found.reshape(len(trials), -1))

    return np.asarray(fit(replace(options, starts=1).start(box_of(space), 1), residuals).point)


def _standing(push: TripodPush, support: SupportPoints | UniformPressure) -> TripodPush:
    case = push.target.case
    body = replace(case.scene.bodies[0], support=support)
    scene = replace(case.scene, bodies=(body,))
    return push._replace(target=push.target._replace(case=case._replace(scene=scene)))


def _errors(pushes: Sequence[TripodPush], point: FloatArray) -> Row:
    comparer = comparer_of(pushes, shared_space())
    n = len(pushes)
    difference, good, _ = comparer.differences(np.arange(n), np.tile(point, (n, 1)))
    position = np.hypot(difference[:, -1, 0], difference[:, -1, 1]) * 1e3
    angle = np.degrees(np.abs(difference[:, -1, 2]))
    return {
        "solved": int(good.sum()),
        "position_mm_mean": float(position.mean()),
        "position_mm_median": float(np.median(position)),
        "angle_deg_mean": float(angle.mean()),
        "angle_deg_median": float(np.median(angle)),
    }


def _conclusions(found: list[Row], friction: list[Row], transfer: list[Row]) -> list[str]:
    sentences = []
    for row in found:
        sentences.append(
            f"{row['support']}, from {row['from']}: {row['distance_mm_rms']:.1f} mm RMS from the"
            f" machined points, {row['distance_mm_load_weighted']:.1f} mm weighted with the load;"
            f" mean radius {row['mean_radius_mm']:.1f} mm for {row['mean_radius_mm_machined']:.1f}."
        )
        if "distance_mm_rms_attainable" in row:
            sentences.append(
                f"{row['support']}: pushes simulated on the machined points, with the same noise,"
                f" give {row['distance_mm_rms_attainable']:.1f} mm."
            )
    for row in friction:
        if row["support"] == "all":
            sentences.append(
                f"{row['surface']}: friction {row['mu']:.3f} from forces, the authors say"
                f" {row['mu_authors']:.3f}."
            )
    for name in dict.fromkeys(row["points"] for row in transfer):
        for learnt in ("nothing", "other supports"):
            own = [
                row
                for row in transfer
                if row["points"] == name and row["finger_and_registration"] == learnt
            ]
            mean = np.average(
                [r["position_mm_mean"] for r in own], weights=[r["pushes"] for r in own]
            )
            turn = np.average(
                [r["angle_deg_mean"] for r in own], weights=[r["pushes"] for r in own]
            )
            sentences.append(
                f"Points {name}, with {learnt} learnt: {mean:.2f} mm and {turn:.2f} deg on average."
            )
    return sentences
