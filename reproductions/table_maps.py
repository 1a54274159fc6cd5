"""Maps of uneven tables on real pushes: plates never seen, sides never pushed, another session."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from fixel.calibration.target import target_of
from fixel.datasets.mit_push import read_mit_pushes
from fixel.drawing.chart import WIDE, sheet
from fixel.model import Experiment, pose_error
from fixel.parts.fit import NAMES, PartPushes, learned_prior
from fixel.parts.left_out import after, chosen_order, halves
from fixel.parts.model import PartModel
from fixel.parts.table_map import UNSEEN, TableMap, half_of_outline
from fixel.replay.base import Row
from fixel.typing import BoolArray, FloatArray, IntArray
from fixel.workflows.parts import part_model
from fixel.workflows.table_map import table_map
from reproductions.new_parts import DEGREE, DRAWS, plates_of
from reproductions.result import Reproduction, RunOptions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUNTS: Final = (0, 3, 10)  # pushes of a new plate, chosen by worth
MAX_TEST: Final = 100
BOOTSTRAP: Final = 2000
FOLDS: Final = 3  # in which equal pushes are held out
# Two pushes with the same contact are at the same place and orientation if closer than this.
NEAR: Final = (20e-3, np.radians(20.0))
CLIP: Final = 12e-3  # of an error that counts in shares [m]
ARM: Final = 35e-3  # [m/rad]
LARGEST: Final = 1.5  # log load of the colours
Key = tuple[str, str]
Split = Callable[[Sequence[Experiment]], BoolArray]  # which pushes of a plate are held out


class PairedErrors(NamedTuple):
    """Errors of the same pushes of one plate, without and with the map [mm, deg]."""

    what: str
    key: Key
    before: FloatArray  # (n, 2)
    after: FloatArray


def run(options: RunOptions) -> Reproduction:
    """Predict pushes with and without a map of their table."""
    data = read_mit_pushes(options.folder)
    usable = set(data.names[data.usable].tolist())
    every = [own for own in data.experiments if own.name in usable]
    plates = plates_of(every, options.quick)
    surfaces = sorted({surface for surface, _ in plates})
    total = len(plates) + 5 * len(surfaces)
    found: list[PairedErrors] = []
    maps: dict[str, TableMap] = {}
    shares: list[Row] = []
    done = 0
    with tempfile.TemporaryDirectory() as folder:
        store = options.fits / "new-parts" if options.fits else Path(folder)
        model = _model([one for some in plates.values() for one in some], store)
    for surface in surfaces:
        own = {key: some for key, some in plates.items() if key[0] == surface}
        maps[surface] = table_map(_joined(own.values()), model, progress=False)
        for key in own:
            found += _new_plate(key, own, model, COUNTS[:1] if options.quick else COUNTS)
            options.progress(done := done + 1, total, " ".join(key))
        splits: dict[str, Split] = {
            "sides": partial(_half, side=1), "other sides": partial(_half, side=0),
            "session": _later_session, "random": _random,
        }  # fmt: skip
        for what, split in splits.items():
            found += _known_plates(what, own, split)[0]
            options.progress(done := done + 1, total, f"{surface} {what}")
        shares += _repeated(surface, own if options.quick else _with_repeats(own, every))
        options.progress(done := done + 1, total, f"{surface} repeats")
    rows = _rows(found)
    return Reproduction(
        tables={"errors": rows, "plates": _plate_rows(found), "repeats": shares},
        conclusions=[*_sentences(rows), *map(repr, maps.values())],
        settings={"draws": DRAWS, "quick": options.quick},
        figure=partial(_figure, maps),
    )


def _model(experiments: Sequence[Experiment], store: Path) -> PartModel:
    return part_model(experiments, part="shape", surface="surface", store=store, progress=False)


def _joined(some: Iterable[Sequence[Experiment]]) -> list[Experiment]:
    return [one for own in some for one in own]


def _new_plate(
    key: Key, plates: Mapping[Key, list[Experiment]], model: PartModel, counts: Sequence[int]
) -> list[PairedErrors]:
    """Predict a plate from the others, after a number of its own pushes."""
    table = table_map(
        _joined(some for k, some in plates.items() if k != key), model, progress=False
    )
    own = plates[key]
    bare = PartPushes([target_of(one) for one in own])
    mapped = PartPushes([target_of(table.on(one)) for one in own])
    # What plates have in common comes from the other plates, of both tables.
    flat, uneven = (
        learned_prior([fit for fit in some.fits if fit.part != key[1]], key[0], model.share)
        for some in (model, table.corrected(model))
    )
    found = []
    for count in counts:
        errors: tuple[list[FloatArray], list[FloatArray]] = ([], [])
        for draw in range(DRAWS):
            pool, test = halves(len(own), 100 + draw)
            test = np.sort(test[:MAX_TEST])
            which = chosen_order(bare, pool, flat, count) if count else pool[:0]
            for pushes, prior, kept in zip((bare, mapped), (flat, uneven), errors, strict=True):
                best = (after(pushes, which, prior) if count else prior).best
                values = dict(zip(NAMES, best.tolist(), strict=True))
                if pushes is mapped and count:
                    taught = table.with_part([own[k] for k in which.tolist()], values)
                    ends = taught.predict([own[k] for k in test.tolist()])
                else:
                    given = {name: np.full(len(test), x) for name, x in values.items()}
                    ends = pushes.simulate(test, given)[0]
                kept.append(pushes.errors(test, ends) * [1e3, DEGREE])
        before, with_map = (np.concatenate(kept) for kept in errors)
        found.append(PairedErrors(f"new plate, {count} pushes", key, before, with_map))
    return found


# --- known plates ---------------------------------------------------------------------------------


def _known_plates(
    what: str, plates: Mapping[Key, list[Experiment]], split: Split
) -> tuple[list[PairedErrors], dict[Key, FloatArray]]:
    """Predict pushes that a split holds out; return also residuals (n, 2, 3) without and with."""
    held = {key: split(own) for key, own in plates.items()}
    taught = {key: [one for one, out in zip(own, held[key], strict=True) if not out]
              for key, own in plates.items()}  # fmt: skip
    if not any(out.any() for out in held.values()):
        return [], {}
    with tempfile.TemporaryDirectory() as folder:
        model = _model(_joined(taught.values()), Path(folder))
    table = table_map(_joined(taught.values()), model, progress=False)
    found, residuals = [], {}
    for key, own in plates.items():
        test = [one for one, out in zip(own, held[key], strict=True) if out]
        residuals[key] = np.full((len(own), 2, 3), np.nan)
        if test:
            pushes = PartPushes([target_of(one) for one in test])
            every = np.arange(len(test))
            given = {name: np.full(len(test), x) for name, x in table.values[key[1]].items()}
            ends = [pushes.simulate(every, given)[0], table.predict(test)]
            before, with_map = (pushes.errors(every, end) * [1e3, DEGREE] for end in ends)
            found.append(PairedErrors(what, key, before, with_map))
            residuals[key][held[key]] = np.stack([_residual(pushes, end) for end in ends], axis=1)
    return found, residuals


def _residual(pushes: PartPushes, ends: FloatArray) -> FloatArray:
    """Return differences (n, 3) from the measured ends, in the plates' frames at the start [m]."""
    away = ends - pushes.end
    c, s = np.cos(pushes.start[:, 2]), np.sin(pushes.start[:, 2])
    x, y = away[:, 0], away[:, 1]
    turn = ARM * pose_error(ends, pushes.end)[1]
    return np.column_stack((c * x + s * y, c * y - s * x, turn))


def _half(own: Sequence[Experiment], side: int) -> BoolArray:
    """Return which pushes begin on one half of the outline."""
    return np.equal(half_of_outline(PartPushes([target_of(one) for one in own])), side)


def _later_session(own: Sequence[Experiment]) -> BoolArray:
    """Return which pushes were made at the higher speed, in a session of its own."""
    speed = np.array([one.conditions["speed_m_s"] for one in own], np.float64)
    return np.asarray(speed > speed.min())


def _random(own: Sequence[Experiment]) -> BoolArray:
    """Return a random 40 % of the pushes, with all repeats of a push."""
    index = _index(own)
    names = np.unique(index)
    out = np.random.default_rng(0).permutation(names)[: round(0.4 * len(names))]
    return np.isin(index, out)


def _index(own: Sequence[Experiment]) -> IntArray:
    """Return the number of each push in its list: equal ones have equal contacts."""
    return np.array([int(one.name.rsplit("_", 1)[1]) for one in own])


def _with_repeats(
    plates: Mapping[Key, list[Experiment]], every: Sequence[Experiment]
) -> dict[Key, list[Experiment]]:
    """Return the plates with all pushes of those that were pushed in two sessions."""
    whole: dict[Key, list[Experiment]] = {key: [] for key in plates}
    for one in every:
        key = str(one.conditions["surface"]), str(one.conditions["shape"])
        if key in whole and one.scene is not None:
            whole[key].append(one)
    return {key: whole[key] if _later_session(whole[key]).any() else plates[key] for key in plates}


def _fold(own: Sequence[Experiment], fold: int) -> BoolArray:
    """Return which pushes are in one of `FOLDS` random parts, with all repeats of a push."""
    index = _index(own)
    return np.isin(index, np.random.default_rng(0).permutation(np.unique(index))[fold::FOLDS])


def _repeated(surface: str, plates: Mapping[Key, list[Experiment]]) -> list[Row]:
    """Return the share of squared residuals that equal pushes have in common.

    All pushes are held out once, together with their repeats.
    """
    if not any(_later_session(own).any() for own in plates.values()):
        return []
    residuals = {key: np.full((len(own), 2, 3), np.nan) for key, own in plates.items()}
    for fold in range(FOLDS):
        for key, found in _known_plates("", plates, partial(_fold, fold=fold))[1].items():
            residuals[key] = np.where(np.isfinite(found), found, residuals[key])
    pairs: dict[str, list[FloatArray]] = {"near": [], "elsewhere": []}
    for key, own in plates.items():
        index = _index(own)
        pose = np.array([one.trajectory.pose[0] for one in own])
        for number in np.unique(index):
            pair = np.flatnonzero(index == number)
            if len(pair) == 2:
                away, turn = pose_error(pose[pair[:1]], pose[pair[1:]])
                near = away[0] < NEAR[0] and abs(turn[0]) < NEAR[1]
                pairs["near" if near else "elsewhere"].append(residuals[key][pair])
    rows: list[Row] = []
    for where, some in pairs.items():
        for k, kind in enumerate(("without map", "with map") if some else ()):
            share, low, high = _share(np.clip(np.array(some)[:, :, k, :2], -CLIP, CLIP))
            row: Row = {"surface": surface, "pairs": len(some), "where": where, "model": kind}
            rows.append(row | {"share": share, "share_low": low, "share_high": high})
    return rows


def _share(pairs: FloatArray) -> tuple[float, float, float]:
    """Return the common share of squared errors (n, 2, 2) of pairs, and its 95 % interval."""
    both = 2.0 * pairs.prod(axis=1).sum(axis=1), np.square(pairs).sum(axis=(1, 2))
    drawn = np.random.default_rng(0).integers(0, len(pairs), (BOOTSTRAP, len(pairs)))
    low, high = np.percentile(both[0][drawn].sum(1) / both[1][drawn].sum(1), (2.5, 97.5)).tolist()
    return float(both[0].sum() / both[1].sum()), low, high


# --- tables ---------------------------------------------------------------------------------------


def _rows(found: Sequence[PairedErrors]) -> list[Row]:
    """Return mean errors and paired changes, with 95 % intervals over pushes and over plates."""
    rows: list[Row] = []
    merged = [own._replace(what="sides") if own.what == "other sides" else own for own in found]
    for what in dict.fromkeys(own.what for own in merged):
        for surface in ("", *dict.fromkeys(own.key[0] for own in merged)):
            some = [own for own in merged if own.what == what and own.key[0].startswith(surface)]
            if not some:
                continue
            before, with_map = (np.concatenate([own[k] for own in some]) for k in (2, 3))
            plate = np.concatenate([[own.key[1]] * len(own.before) for own in some])
            change = with_map - before
            worst = max(some, key=lambda own: float((own.after - own.before)[:, 0].mean()))
            row: Row = {"held_out": what, "surface": surface or "all", "pushes": len(before)}
            for k, unit in enumerate(("mm", "deg")):
                row |= {
                    f"before_{unit}": before[:, k].mean(),
                    f"after_{unit}": with_map[:, k].mean(),
                }
                for name, labels in (("pushes", np.arange(len(plate))), ("plates", plate)):
                    low, high = _interval(change[:, k], labels)
                    row |= {f"change_{unit}_{name}_low": low, f"change_{unit}_{name}_high": high}
            row["worst"] = " ".join(worst.key)
            row["worst_change_mm"] = float((worst.after - worst.before)[:, 0].mean())
            rows.append(row)
    return rows


def _interval(change: FloatArray, labels: np.ndarray) -> tuple[float, float]:
    """Return the 95 % interval of a mean when units are drawn again."""
    _, unit = np.unique(labels, return_inverse=True)
    total, count = np.bincount(unit, change), np.bincount(unit)
    draws = np.random.default_rng(0).integers(0, len(total), (BOOTSTRAP, len(total)))
    means = total[draws].sum(axis=1) / count[draws].sum(axis=1)
    low, high = np.percentile(means, (2.5, 97.5)).tolist()
    return low, high


def _plate_rows(found: Sequence[PairedErrors]) -> list[Row]:
    rows: list[Row] = []
    for own in found:
        row: Row = {"held_out": own.what, "surface": own.key[0], "shape": own.key[1]}
        for name, errors in (("before", own.before), ("after", own.after)):
            row[f"{name}_mm"], row[f"{name}_deg"] = errors.mean(axis=0).tolist()
        rows.append(row)
    return rows


def _sentences(rows: Sequence[Row]) -> list[str]:
    return [
        f"{row['held_out']}, {row['surface']}: {row['before_mm']:.2f} mm,"
        f" {row['before_deg']:.2f} deg without a map; {row['after_mm']:.2f} mm,"
        f" {row['after_deg']:.2f} deg with it (worst plate {row['worst']}"
        f" {row['worst_change_mm']:+.2f} mm)."
        for row in rows
    ]


def _figure(maps: Mapping[str, TableMap]) -> Figure:
    """Draw the maps where pushes have seen them."""
    figure = sheet(WIDE, 3.4)
    panels = np.ravel(figure.subplots(1, len(maps), squeeze=False))
    for axes, (name, table) in zip(panels, maps.items(), strict=True):
        grid = table.load_map
        n_y, n_x = grid.log_load.shape
        (x, y), (step_x, step_y) = 1e3 * grid.origin, 1e3 * grid.cell
        seen = np.ma.masked_where(table.deviation > UNSEEN, grid.log_load)
        places = x + step_x * np.arange(n_x), y + step_y * np.arange(n_y)
        drawn = axes.pcolormesh(*places, seen, cmap="RdBu_r", vmin=-LARGEST, vmax=LARGEST)
        axes.set(title=name, xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
        figure.colorbar(drawn, ax=axes, label="logarithm of the load factor [-]")
    return figure
