"""Predictions and bounds for plates that were never pushed, and after their first pushes.

Every plate is left out with both its surfaces: nothing that predicts it has seen it. The model is
`fixel.part_model` of the other plates, which chooses and judges by leaving plates out once more
(inner estimates); the errors reported here are of the plate that it has not seen (outer).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from fixel.calibration.known_pushes import contacts_of
from fixel.calibration.target import target_of
from fixel.datasets.mit_push import NOMINAL, read_mit_pushes
from fixel.domain.error_bound import TYPICAL, ConformalBound
from fixel.model import Experiment, wrapped
from fixel.parts.fit import PartPushes, simulated
from fixel.parts.left_out import after, chosen_order, halves, leave_parts_out
from fixel.parts.model import EndPrediction, PartModel
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.workflows.parts import part_model
from reproductions.charts.new_parts import new_parts_figure
from reproductions.mit_push import PUBLISHED
from reproductions.result import Reproduction, RunOptions

COUNTS: Final = (0, 1, 2, 3, 5, 10, 15, 20)  # pushes of the new plate
BOUND_COUNTS: Final = (0, 3, 10)
DRAWS: Final = 2  # random halves of a plate: one to learn from, one to predict
MAX_PUSHES: Final = 250  # of each plate on each surface
MAX_TEST: Final = 125
QUICK_SHAPES, QUICK_PUSHES, QUICK_COUNTS = 4, 40, (0, 3)
RANDOM, CHOSEN = "random", "chosen"
DEGREE: Final = 180.0 / np.pi
SAME_SIDE: Final = np.radians(20.0)


class Score(NamedTuple):
    """Errors and bounds of the pushes of one plate on one surface after k pushes."""

    group: tuple[str, str]  # surface, plate
    rule: str
    pushes: int
    errors: FloatArray  # (n, 2) [mm, deg]
    typical: FloatArray  # (n, 2), inf without a bound
    cautious: FloatArray  # (n, 2)
    constant: FloatArray  # (2,) typical bound without features
    named: BoolArray  # (n,) whether the plate is named as unseen before anything else
    known_side: BoolArray  # (n,)


def run(options: RunOptions) -> Reproduction:
    """Predict plates that were left out with both their surfaces."""
    data = read_mit_pushes(options.folder)
    published = dict(zip(data.names.tolist(), data.published[PUBLISHED], strict=True))
    usable = set(data.names[data.usable].tolist())
    plates = plates_of([own for own in data.experiments if own.name in usable], options.quick)
    names = sorted({plate for _, plate in plates})
    counts = QUICK_COUNTS if options.quick else COUNTS
    scores: list[Score] = []
    baselines: list[Row] = []
    inner: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        store = options.fits / "new-parts" if options.fits else Path(folder)
        for done, name in enumerate(names):
            others = [own for key, some in plates.items() if key[1] != name for own in some]
            model = part_model(others, part="shape", surface="surface", store=store, progress=False)
            models = _models(model, counts)
            inner += _inner(name, models)
            for key, experiments in plates.items():
                if key[1] == name:
                    scores += _scores(key, experiments, models, counts)
                    baselines.append(_baseline(key, experiments, published))
            options.progress(done + 1, len(names), name)
        surfaces = _new_surface(plates, store)
    tables = {
        "errors": _error_rows(scores, baselines, counts),
        "plates": _plate_rows(scores, baselines, counts),
        "bounds": _bound_rows(scores, counts),
        "inner": inner,
        "surfaces": surfaces,
    }
    return Reproduction(
        tables=tables,
        conclusions=_conclusions(tables),
        settings={"draws": DRAWS, "counts": list(counts), "quick": options.quick},
        figure=partial(new_parts_figure, tables["errors"], tables["bounds"]),
    )


def plates_of(
    experiments: Sequence[Experiment], quick: bool
) -> dict[tuple[str, str], list[Experiment]]:
    """Return the pushes of each plate on each surface, at most `MAX_PUSHES` random ones."""
    found: dict[tuple[str, str], list[Experiment]] = {}
    for own in experiments:
        if own.scene is not None:
            key = str(own.conditions["surface"]), str(own.conditions["shape"])
            found.setdefault(key, []).append(own)
    keys = sorted(found)
    if quick:
        keys = [key for key in keys if key[0] == keys[0][0]][:QUICK_SHAPES]
    most = QUICK_PUSHES if quick else MAX_PUSHES
    some: dict[tuple[str, str], list[Experiment]] = {}
    for key in keys:
        order = np.random.default_rng(0).permutation(len(found[key]))[:most]
        some[key] = [found[key][k] for k in np.sort(order).tolist()]
    return some


def _new_surface(plates: dict[tuple[str, str], list[Experiment]], store: Path) -> list[Row]:
    """Return errors and coverage on plates that were left out together with their surface."""
    rows: list[Row] = []
    for key, experiments in plates.items():
        others = [
            own
            for (surface, plate), some in plates.items()
            for own in some
            if surface != key[0] and plate != key[1]
        ]
        if not others:
            continue
        model = part_model(others, part="shape", surface="surface", store=store, progress=False)
        found = model.predict(experiments)
        pushes = PartPushes([target_of(own) for own in experiments])
        ends = np.array([tuple(own.pose) for own in found])
        errors = pushes.errors(np.arange(len(pushes)), ends)
        row: Row = {"surface": key[0], "shape": key[1], "share": model.share}
        row["position_mm"], row["angle_deg"] = (errors.mean(axis=0) * [1e3, DEGREE]).tolist()
        for column, name in enumerate(("position", "angle")):
            for kind, field in (("typical", name), ("cautious", f"cautious_{name}")):
                bound = [getattr(own.bound, field) for own in found]
                known = np.array([np.inf if x is None else x for x in bound])
                row[f"{kind}_{name}_coverage"] = float((errors[:, column] <= known).mean())
        rows.append(row)
    return rows


def _models(model: PartModel, counts: Sequence[int]) -> dict[tuple[str, int], PartModel]:
    """Return the model with bounds judged after each number of pushes."""
    found = {}
    for k in counts:
        for rule in (RANDOM, CHOSEN) if k else (RANDOM,):
            own = model
            if k in BOUND_COUNTS and k:
                left = leave_parts_out(
                    model._groups, model.fits, model.share, k, chosen=rule == CHOSEN
                )
                own = replace(model, left_out=left, chosen=rule == CHOSEN)
            found[rule, k] = own
    return found


def _scores(
    key: tuple[str, str],
    experiments: Sequence[Experiment],
    models: dict[tuple[str, int], PartModel],
    counts: Sequence[int],
) -> list[Score]:
    """Predict a plate on a surface after each number of pushes, chosen at random and by worth."""
    scores = []
    pushes = PartPushes([target_of(own) for own in experiments])
    for draw in range(DRAWS):
        pool, test = halves(len(experiments), 100 + draw)
        test = np.sort(test[:MAX_TEST])
        model = models[RANDOM, 0]
        prior = model.distribution(*key)
        orders = {RANDOM: pool, CHOSEN: chosen_order(pushes, pool, prior, max(counts))}
        for (rule, k), own in models.items():
            which = orders[rule][:k]
            if len(which) < k:
                continue
            if k not in BOUND_COUNTS:
                values = after(pushes, which, prior).mean
                ends, _ = simulated(pushes, test, values[None])
                scores.append(_score_of_ends(key, rule, k, pushes.errors(test, ends[0])))
                continue
            given = [experiments[j] for j in which.tolist()]
            taught = own.after(given, chosen=rule == CHOSEN) if k else own
            found = taught.predict([experiments[j] for j in test.tolist()])
            scores.append(_score(key, rule, k, pushes, which, test, found, taught))
    return scores


def _score_of_ends(key: tuple[str, str], rule: str, k: int, errors: FloatArray) -> Score:
    """Return a score of predictions whose bounds are not judged."""
    none = np.zeros((0, 2))
    errors = errors * [1e3, DEGREE]
    return Score(
        key, rule, k, errors, none, none, np.full(2, np.inf), none[:, 0] > 0, none[:, 0] > 0
    )


def _score(
    key: tuple[str, str],
    rule: str,
    k: int,
    pushes: PartPushes,
    which: IntArray,
    test: IntArray,
    found: Sequence[EndPrediction],
    model: PartModel,
) -> Score:
    ends = np.array([tuple(own.pose) for own in found])
    scale = np.array([1e3, DEGREE])

    def bounds(first: str, second: str) -> FloatArray:
        rows = [(getattr(own.bound, first), getattr(own.bound, second)) for own in found]
        table: FloatArray = np.array([[np.inf if x is None else x for x in row] for row in rows])
        return np.asarray(table * scale)

    return Score(
        key,
        rule,
        k,
        scale * pushes.errors(test, ends),
        bounds("position", "angle"),
        bounds("cautious_position", "cautious_angle"),
        scale * _constant(model),
        np.array([key[1] in (*own.bound.unseen, "")[0] for own in found]),
        _known_side(pushes, which, test),
    )


def _constant(model: PartModel) -> FloatArray:
    """Return the typical bounds (2,) of a model of errors without features."""
    left = model.left_out
    return np.array(
        [
            ConformalBound.fit(
                left.features, left.errors[:, column], left.part, model="constant",
                units=left.group, rule=TYPICAL,
            ).bounds(left.features[:1], left.part[:1])[0]
            for column in (0, 1)
        ]
    )  # fmt: skip


def _known_side(pushes: PartPushes, which: IntArray, test: IntArray) -> BoolArray:
    """Return which pushes begin on a side that one of the learned ones has pushed."""
    every = np.arange(len(pushes))
    normal = contacts_of(pushes.configurations(every), np.ones(len(pushes))).normal
    if not len(which):
        return np.zeros(len(test), bool)
    turn = np.abs(wrapped(normal[test][:, None] - normal[which][None]))
    return np.asarray(turn.min(axis=1) <= SAME_SIDE)


def _baseline(
    key: tuple[str, str], experiments: Sequence[Experiment], published: dict[str, FloatArray]
) -> Row:
    """Return errors of even pressure and of the published simulator on all pushes of a plate."""
    pushes = PartPushes([target_of(own) for own in experiments])
    every = np.arange(len(pushes))
    even, _ = pushes.simulate(every, {"mu_pusher": np.full(len(every), NOMINAL["mu_pusher"])})
    theirs = np.array([published[own.name] for own in experiments])
    row: Row = {"group": key}
    for name, ends in (("even", even), ("published", theirs)):
        own = np.nanmean(pushes.errors(every, ends), axis=0) * [1e3, DEGREE]
        row[f"{name}_mm"], row[f"{name}_deg"] = own.tolist()
    return row


# --- tables ---------------------------------------------------------------------------------------


def _means(scores: Sequence[Score]) -> FloatArray:
    """Return mean errors (2,) over pushes; all groups and draws have about as many."""
    mean: FloatArray = np.concatenate([own.errors for own in scores]).mean(axis=0)
    return mean


def _error_rows(
    scores: Sequence[Score], baselines: Sequence[Row], counts: Sequence[int]
) -> list[Row]:
    rows: list[Row] = []
    plates = sorted({own.group[1] for own in scores})
    for name in ("even", "published"):
        mean = np.mean([[row[f"{name}_{unit}"] for unit in ("mm", "deg")] for row in baselines], 0)
        rows.append({"model": name, "position_mm": mean[0], "angle_deg": mean[1]})
    for rule in (RANDOM, CHOSEN):
        for k in counts:
            own = [s for s in scores if s.pushes == k and s.rule == (rule if k else RANDOM)]
            if not own:
                continue
            mean = _means(own)
            worse = []
            better = [0, 0]
            for plate in plates:
                some = [s for s in own if s.group[1] == plate]
                first = [s for s in scores if s.pushes == 0 and s.group[1] == plate]
                even = np.mean(
                    [[r["even_mm"], r["even_deg"]] for r in baselines if r["group"][1] == plate], 0
                )
                here = _means(some)
                better = [n + int(x < y) for n, x, y in zip(better, here, even, strict=True)]
                worse.append(here - _means(first))
            rows.append(
                {
                    "model": rule, "pushes": k, "position_mm": mean[0], "angle_deg": mean[1],
                    "plates_better_than_even_mm": better[0],
                    "plates_better_than_even_deg": better[1],
                    "worst_change_mm": float(np.max([w[0] for w in worse])),
                    "worst_change_deg": float(np.max([w[1] for w in worse])),
                }
            )  # fmt: skip
    return rows


def _plate_rows(
    scores: Sequence[Score], baselines: Sequence[Row], counts: Sequence[int]
) -> list[Row]:
    rows = []
    for base in baselines:
        row: Row = {"surface": base["group"][0], "shape": base["group"][1]}
        row |= {name: value for name, value in base.items() if name != "group"}
        for k in counts:
            rule = CHOSEN if k else RANDOM
            own = [s for s in scores if (s.group, s.pushes, s.rule) == (base["group"], k, rule)]
            if own:
                row[f"after_{k}_mm"], row[f"after_{k}_deg"] = _means(own).tolist()
        rows.append(row)
    return rows


def _bound_rows(scores: Sequence[Score], counts: Sequence[int]) -> list[Row]:
    """Return coverage and width of bounds: mean over groups, and worst group."""
    rows: list[Row] = []
    groups = sorted({own.group for own in scores})
    for k in (n for n in BOUND_COUNTS if n in counts):
        for rule in (RANDOM, CHOSEN) if k else (RANDOM,):
            for column, error in enumerate(("position", "angle")):
                row: Row = {"pushes": k, "rule": rule, "error": error}
                for kind in ("typical", "cautious"):
                    cover, width = {}, []
                    for group in groups:
                        own = [s for s in scores
                               if (s.group, s.pushes, s.rule) == (group, k, rule)]  # fmt: skip
                        if own:
                            bound = np.concatenate([getattr(s, kind)[:, column] for s in own])
                            off = np.concatenate([s.errors[:, column] for s in own])
                            cover[" ".join(group)] = float((off <= bound).mean())
                            width.append(float(bound[np.isfinite(bound)].mean()))
                    worst = min(cover, key=lambda name: cover[name])
                    row[f"{kind}_coverage"] = float(np.mean(list(cover.values())))
                    row[f"{kind}_worst"], row[f"{kind}_worst_group"] = cover[worst], worst
                    row[f"{kind}_mean"] = float(np.mean(width))
                own = [s for s in scores if s.pushes == k and s.rule == rule]
                row["constant_mean"] = float(np.mean([s.constant[column] for s in own]))
                row |= _sharpness(own, column)
                row["named"] = float(np.concatenate([s.named for s in own]).mean())
                rows.append(row)
    return rows


def _sharpness(scores: Sequence[Score], column: int) -> Row:
    """Return how much narrower bounds are than a constant, on all and on known sides."""
    found: Row = {}
    for name, known in (("sharper", False), ("sharper_known_sides", True)):
        ratios = []
        for own in scores:
            which = own.known_side if known else np.ones(len(own.errors), bool)
            bound = own.typical[which, column]
            if len(bound) and np.isfinite(bound).any():
                ratios.append(float(bound[np.isfinite(bound)].mean() / own.constant[column]))
        found[name] = 1.0 - float(np.mean(ratios)) if ratios else None
    return found


def _inner(name: str, models: dict[tuple[str, int], PartModel]) -> list[Row]:
    """Return the errors that a model expects for a plate that it has not seen."""
    rows = []
    for (rule, k), own in models.items():
        if k in BOUND_COUNTS:
            errors = own.left_out.errors
            mean = errors[np.isfinite(errors).all(axis=1)].mean(axis=0) * [1e3, DEGREE]
            rows.append(
                {"left_out": name, "rule": rule, "pushes": k, "share": own.share,
                 "position_mm": mean[0], "angle_deg": mean[1]}
            )  # fmt: skip
    return rows


def _conclusions(tables: dict[str, list[Row]]) -> list[str]:
    lines = [
        f"{row['model']}{'' if 'pushes' not in row else ', ' + str(row['pushes']) + ' pushes'}:"
        f" {row['position_mm']:.2f} mm, {row['angle_deg']:.2f} deg"
        for row in tables["errors"]
    ]
    for row in tables["bounds"]:
        unit = "mm" if row["error"] == "position" else "deg"
        lines.append(
            f"90 % bounds of the {row['error']} after {row['pushes']} {row['rule']} pushes:"
            f" typical {100 * row['typical_coverage']:.1f} % (worst group"
            f" {100 * row['typical_worst']:.0f} %), {row['typical_mean']:.2f} {unit}; cautious"
            f" {100 * row['cautious_coverage']:.1f} % ({100 * row['cautious_worst']:.0f} %,"
            f" {row['cautious_worst_group']}), {row['cautious_mean']:.2f} {unit}"
        )
    for k in sorted({row["pushes"] for row in tables["inner"]}):
        some = [row for row in tables["inner"] if row["pushes"] == k and row["rule"] == RANDOM]
        mean = np.mean([[row["position_mm"], row["angle_deg"]] for row in some], axis=0)
        lines.append(
            f"Inner estimate after {k} random pushes: {mean[0]:.2f} mm, {mean[1]:.2f} deg."
        )
    if tables["surfaces"]:
        mean = {
            name: float(np.mean([row[name] for row in tables["surfaces"]]))
            for name in tables["surfaces"][0]
            if name not in ("surface", "shape")
        }
        lines.append(
            f"Left out with their surface, no push: {mean['position_mm']:.2f} mm,"
            f" {mean['angle_deg']:.2f} deg; typical bounds hold for"
            f" {100 * mean['typical_position_coverage']:.1f} % of positions and"
            f" {100 * mean['typical_angle_coverage']:.1f} % of angles, cautious ones for"
            f" {100 * mean['cautious_position_coverage']:.1f} % and"
            f" {100 * mean['cautious_angle_coverage']:.1f} %."
        )
    named = [row["named"] for row in tables["bounds"]]
    lines.append(f"Pushes whose plate is named as unseen first: {100 * min(named):.0f} %.")
    return lines
