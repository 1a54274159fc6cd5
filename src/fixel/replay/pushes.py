"""Replay of straight pushes with known start and end (`mit_push_endpoints`), group by group."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from fixel.datasets.mit_push import NOMINAL, STROKE, read_mit_pushes
from fixel.datasets.mit_push_records import TIP
from fixel.model import Scene
from fixel.replay import base
from fixel.simulation import BatchResult, simulate_batch
from fixel.simulation.motion import motion_model
from fixel.typing import FloatArray, IntArray

# Quantiles of the error at which pushes are drawn as examples.
EXAMPLES_AT = (0.25, 0.5, 0.75, 0.9)

Group = tuple[str, str, float]  # surface, shape, speed [mm/s]
Errors = dict[str, tuple[FloatArray, FloatArray]]  # model -> position [mm], angle [deg]


@final
class PushReplay(base.AbstractReplay):
    """Pushes from their measured start along their measured stroke, in one batch per group."""

    def __init__(self, folder: Path, request: base.ReplayRequest) -> None:
        self.data = read_mit_pushes(folder)
        self.everything = request.everything
        self.settings = base.settings_from(NOMINAL, request.settings)
        self.motion = motion_model(request.motion or "quasistatic")
        self.chosen, self.left_out = self._usable(request)
        self.groups = self._groups()
        self.parts = []
        for (surface, shape, speed), rows in self.groups.items():
            pace = speed * 1e-3  # [m/s]
            scene = base.template(self.data.bodies[shape], TIP, self.settings, pace, STROKE / pace)
            name = f"{surface} {shape} {speed:g} mm/s"
            self.parts.append((name, len(rows), (rows, scene)))

    def simulate(self, item: tuple[IntArray, Scene]) -> BatchResult:
        """Simulate pushes that share a scene, in one compiled call."""
        rows, scene = item
        waypoints = np.zeros((len(rows), 2, 4))
        waypoints[:, 1, 0] = scene.duration
        waypoints[:, 0, 1:3] = self.data.tip_start[rows]
        waypoints[:, 1, 1:3] = self.data.tip_end[rows]
        start = self.data.start[rows]
        return simulate_batch(scene, start=start, waypoints=waypoints, motion=self.motion)

    def result(self, outcomes: list[BatchResult]) -> base.Replay:
        """Compare simulated and published ends with the measured ones."""
        data, chosen = self.data, self.chosen
        end = np.full((len(data), 3), np.nan)
        status = np.full(len(data), "converged", dtype=object)
        for rows, outcome in zip(self.groups.values(), outcomes, strict=True):
            end[rows] = np.where(outcome.converged[:, None], outcome.final[:, 0], np.nan)
            status[rows] = outcome.status
        ends = {"fixel": end, **data.published}
        errors = {name: base.errors_in_mm_and_deg(own, data.end) for name, own in ends.items()}
        return base.Replay(
            dataset="mit_push_endpoints",
            pushes=self._rows(status, end, errors),
            groups=self._aggregates(errors),
            left_out=self.left_out,
            not_solved=int((status[chosen] != "converged").sum()),
            settings={**self.settings, "motion": self.motion.name, "pusher_radius_m": TIP.radius},
            notes=self._notes(),
            figure=partial(base.pushes_figure, data, chosen, self._examples(errors), ends, errors),
        )

    def _usable(self, request: base.ReplayRequest) -> tuple[IntArray, dict[str, int]]:
        """Rows to replay, and numbers of rows left out by reason."""
        data = self.data
        columns: dict[str, Sequence[object]] = {
            "push_id": data.names.tolist(),
            "surface": data.surface.tolist(),
            "shape": data.shape.tolist(),
            "speed_mm_s": [f"{speed:g}" for speed in (data.speed * 1e3).tolist()],
        }
        fits = base.matching(columns, request.select, len(data))
        reasons = {
            "gap at the start beyond 3 mm or at the end below -3 mm": data.astray,
            "stroke off 50 mm by more than 1 mm": data.short,
        }
        left_out = {}
        if not request.everything:
            left_out = {reason: int((fits & bad).sum()) for reason, bad in reasons.items()}
            fits &= ~data.astray & ~data.short
        rows = np.flatnonzero(fits)
        if not len(rows):
            raise base.only_doubtful("pushes")
        return rows[base.spread(len(rows), request.limit)], {k: n for k, n in left_out.items() if n}

    def _groups(self) -> dict[Group, IntArray]:
        data = self.data
        speeds = np.round(data.speed * 1e3, 6)
        keys = list(zip(data.surface.tolist(), data.shape.tolist(), speeds.tolist(), strict=True))
        return {
            key: np.array([row for row in self.chosen.tolist() if keys[row] == key], dtype=np.intp)
            for key in sorted({keys[row] for row in self.chosen.tolist()})
        }

    def _rows(self, status: NDArray[np.object_], end: FloatArray, errors: Errors) -> list[base.Row]:
        data = self.data
        return [
            {
                "push_id": str(data.names[row]),
                "surface": str(data.surface[row]),
                "shape": str(data.shape[row]),
                "speed_mm_s": round(float(data.speed[row]) * 1e3, 6),
                "status": status[row],
                "end": end[row].tolist(),
                **{
                    f"{name}_{what}": float(values[row])
                    for name, pair in errors.items()
                    for what, values in zip(("position_mm", "angle_deg"), pair, strict=True)
                },
            }
            for row in self.chosen.tolist()
        ]

    def _aggregates(self, errors: Errors) -> list[base.Row]:
        groups: list[tuple[tuple[str, str, float | None], IntArray]] = [*self.groups.items()]
        if len(groups) > 1:
            groups.append((("all", "all", None), self.chosen))
        return [
            {"surface": surface, "shape": shape, "speed_mm_s": speed, **_aggregate(own, errors)}
            for (surface, shape, speed), own in groups
        ]

    def _notes(self) -> list[str]:
        notes = ["Errors are mean / median, over the pushes that all models simulate."]
        if self.left_out:
            reasons = "; ".join(f"{n} with {reason}" for reason, n in self.left_out.items())
            notes.append(f"Skipped: {reasons} (--all includes them).")
        if self.everything:
            notes.append("All pushes are included, also those of doubtful quality.")
        gap = self.data.gap_start[self.chosen]
        notes.append(
            f"{int((gap < 0.0).sum())} pushes start with tip and object overlapping in the"
            f" measurement, by {max(0.0, -1e3 * float(gap.min())):.2f} mm at most;"
            " the first step pushes the object out."
        )
        return notes

    def _examples(self, errors: Errors) -> list[int]:
        """Rows of the pushes at `EXAMPLES_AT`."""
        own = errors["fixel"][0][self.chosen]
        order = self.chosen[np.argsort(np.where(np.isfinite(own), own, np.inf))]
        n = int(np.isfinite(own).sum())
        picked = [int(order[min(int(share * n), n - 1)]) for share in EXAMPLES_AT if n]
        return list(dict.fromkeys(picked))


def _aggregate(rows: IntArray, errors: Errors) -> base.Row:
    """Aggregate the errors of every model, on the rows that all models can predict."""
    common = rows[np.all([np.isfinite(pair[0][rows]) for pair in errors.values()], axis=0)]
    return {
        "pushes": len(common),
        **{
            name: {
                "position_mm": base.mean_and_median(position[common]),
                "angle_deg": base.mean_and_median(angle[common]),
            }
            for name, (position, angle) in errors.items()
        },
    }
