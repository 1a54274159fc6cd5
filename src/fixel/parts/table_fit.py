"""Unevenness of a table from pushes of several parts: derivatives by loads, and a robust fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import scipy.sparse
from scipy.linalg import cho_factor, cho_solve

from fixel.calibration.objective import ANGLE_SCALE
from fixel.errors import InvalidInput
from fixel.model import LoadMap, SupportPoints, wrapped
from fixel.model.trajectory import pose_difference
from fixel.parts.fit import STEP, PartPushes
from fixel.simulation import QuasiStatic, StewartTrinkle
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.pack import pair_tables, supports_of
from fixel.simulation.vary import Variation, redistributed, vary, world_places
from fixel.typing import BoolArray, FloatArray, IntArray

CELL: Final = 20e-3  # distance of the nodes of the map [m]
MARGIN: Final = 60e-3  # of the map beyond the places of support points [m]
MAX_NODES: Final = 1600  # of a map; larger tables have a coarser grid
# Prior of the map: correlation length [m], and standard deviation of a logarithm of a load. From
# 30 to 80 mm and 0.5 to 3 errors on left-out pushes differed by less than 0.05 mm.
LENGTH: Final = 50e-3
DEVIATION: Final = 1.0
# Of the logarithms of the loads on the points of a part: beyond its calibration everywhere, and
# from pose to pose. Friction at the points differs from pose to pose too, without balance.
OWN_DEVIATION: Final = 0.6
POSE_DEVIATION: Final = 1.0
FRICTION_DEVIATION: Final = 0.15
# Poses as far apart as this have different loads [m], [rad].
POSE_LENGTH, POSE_ANGLE = 30e-3, 0.5
MAX_ROWS: Final = 600  # pushes of a part that one fit uses; time grows with their cube
# Values of a part that the fit may correct, with the standard deviations of the corrections and
# the steps of their derivatives.
CORRECTED: Final[Mapping[str, tuple[float, float]]] = {
    "mu_pusher": (0.05, 0.03),
    "registration_x": (0.3e-3, 0.4e-3),
    "registration_y": (0.3e-3, 0.4e-3),
}
LIMIT: Final = 1.5  # of the change of a log load: ends are not linear in larger ones
LOG_STEP: Final = 0.4  # of a load, for its derivatives: ends are rough functions of loads
# Size of what is left of an end [m], most of which is model error: at most this, which counts like
# that of five pushes. Fits leave almost nothing of few pushes, and new ones would suffer from it.
LARGEST_NOISE, IMAGINARY = 2.0e-3, 5.0
MEDIAN: Final = 1.538  # median length of a vector of three standard normal numbers
ROUNDS: Final = 4  # of robust weights
SMALLEST: Final = 1e-4  # share of the largest variance, below which directions of the prior are cut
# Parameters that change loads or points; a part stands on fixed points once these are known.
_OF_LOADS: Final = ("load_", "pressure_", "table_", "support_", "tripod_")


class StandingPart:
    """Pushes of one part with its calibrated values, and derivatives of their ends by loads.

    A part on three points raises `InvalidInput`: their loads are the same on every table.
    """

    def __init__(
        self, pushes: PartPushes, values: Mapping[str, float], *, differentiate: bool = True
    ) -> None:
        self.pushes = pushes
        n = len(pushes)
        scene, body = pushes.cases[0].scene, pushes.body
        flat = replace(scene.plane, load_map=None)
        scene = replace(scene, plane=flat)
        given = {name: np.full(n, x) for name, x in values.items()}
        start = pushes.start[:, None]
        varied = vary(
            scene, supports_of(scene), pair_tables(scene)[0], Variation(given, np.array(start))
        )
        own = varied.elements
        if own.point.shape[-2] < 4 or own.point.ndim > 2 or own.arm.any():
            found = f"a part on {own.point.shape[-2]} points, such as {pushes.targets[0].key}"
            expected = "parts on four or more support points, or with uniform pressure"
            hint = "the loads of three points are the same on every table"
            raise InvalidInput("experiments", found=found, expected=expected, hint=hint)
        self.points = own.point + body.com
        self.outline = start[:, 0] if varied.start is None else varied.start[:, 0]
        self.loads = np.array(np.broadcast_to(own.load, (n, len(self.points))))
        self.loads /= self.loads.mean(axis=1, keepdims=True)
        self.values = {k: v for k, v in given.items() if not k.startswith(_OF_LOADS)}
        support = SupportPoints(
            points=self.points, friction=np.ravel(own.friction)[: len(self.points)]
        )
        cases = []
        for case, pose in zip(pushes.cases, pushes.start, strict=True):
            stands = replace(body, support=support, pose=pose)
            cases.append(case._replace(scene=replace(case.scene, bodies=(stands,), plane=flat)))
        self._ensemble = Ensemble(
            cases, QuasiStatic(), StewartTrinkle(step=STEP), threads=pushes.threads
        )
        self.base, self.good = self._simulated(np.arange(n), self.loads, self.values)
        if differentiate:
            self._differentiate()

    def _differentiate(self) -> None:
        """Simulate all pushes, with every load and value a little larger and smaller."""
        n, p, names = len(self.pushes), len(self.points), list(CORRECTED)
        every, width = np.arange(n), np.array([LOG_STEP] * p + [CORRECTED[k][1] for k in names])
        found = []
        for k, step in enumerate(width.tolist()):
            for change in (step, -step):
                loads, values = self.loads.copy(), dict(self.values)
                if k < p:
                    loads[:, k] *= np.exp(change)
                else:
                    name = names[k - p]
                    values[name] = values.get(name, self._scene_value(name)) + change
                found.append(self._simulated(every, loads, values))
        ends, good = (np.array(own) for own in zip(*found, strict=True))
        away = ends[::2] - ends[1::2]
        away[..., 2] = ANGLE_SCALE * wrapped(away[..., 2])
        slope = np.moveaxis(away / (2.0 * width[:, None, None]), 0, 2)
        self.good &= np.asarray(good.all(axis=0), np.bool_)
        slope[~self.good] = 0.0
        self.by_load, self.by_value = slope[:, :, :p], slope[:, :, p:]

    def _scene_value(self, name: str) -> FloatArray:
        scene = self.pushes.cases[0].scene
        mu = scene.friction(scene.bodies[0].name, scene.pushers[0].name)
        return np.full(len(self.pushes), mu if name == "mu_pusher" else 0.0)

    def _simulated(
        self, which: IntArray, loads: FloatArray, values: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, BoolArray]:
        given = {name: column[which] for name, column in values.items()}
        given |= {f"load_{k + 1}": loads[:, k] for k in range(loads.shape[1])}
        found = self._ensemble.simulate(which, given)
        end = np.where(found.converged[:, None], found.pose[:, -1], self.pushes.start[which])
        return end, found.converged

    def ends(self, which: IntArray, height: FloatArray, own: OwnFit | None = None) -> FloatArray:
        """Simulate pushes `which` (k,) on a table with load factors of given logarithm (k, p).

        Return end poses (k, 3), with what is the part's `own` on the table; the start where a
        simulation failed.
        """
        values, free = dict(self.values), np.zeros(height.shape)
        if own is not None:
            change, free = own.changes(self.middle[which])
            height = height + change
            for name, x in zip(CORRECTED, own.value.tolist(), strict=True):
                values[name] = values.get(name, self._scene_value(name)) + x * CORRECTED[name][0]
            values["mu_pusher"] = np.clip(values["mu_pusher"], 0.02, 0.8)
        loads = redistributed(self.loads[which], np.clip(height, -LIMIT, LIMIT), self.points)
        return self._simulated(which, loads * np.exp(np.clip(free, -LIMIT, LIMIT)), values)[0]

    @property
    def middle(self) -> FloatArray:
        """Poses (n, 3) of the part half way through its simulated pushes."""
        moved = pose_difference(self.base, self.pushes.start)
        return np.asarray(self.pushes.start + 0.5 * moved)

    @property
    def places(self) -> FloatArray:
        """World places (n, p, 2) of the support points at the start [m]."""
        return world_places(self.points, self.outline)

    @property
    def residual(self) -> FloatArray:
        """Measured minus simulated ends (n, 3), angles times their length [m]; 0 without an end."""
        away = self.pushes.end - self.base
        away[:, 2] = ANGLE_SCALE * wrapped(away[:, 2])
        away[~self.good] = 0.0
        return np.asarray(away)

    def balanced(self, factor: FloatArray) -> FloatArray:
        """Take from changes of log loads (n, p, m) what moves the loads' centre or sum."""
        plane = np.column_stack((np.ones(len(self.points)), self.points / LENGTH))
        weight = self.loads + 1e-6
        square = np.einsum("pi,np,pj->nij", plane, weight, plane) + 1e-9 * np.eye(3)
        right = np.einsum("pi,np,npm->nim", plane, weight, factor)
        return np.asarray(factor - np.einsum("pi,nim->npm", plane, np.linalg.solve(square, right)))


class MapGrid(NamedTuple):
    """Nodes of a map, with the square root of the prior covariance of their values."""

    origin: FloatArray  # (2,) of node [0, 0] [m]
    cell: float  # [m]
    shape: tuple[int, int]  # n_y, n_x
    root: FloatArray  # (n_node, m)

    @classmethod
    def over(cls, places: FloatArray) -> MapGrid:
        """Return a grid over places (n, 2) and a margin around them."""
        low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
        cell = max(CELL, float(np.sqrt(np.prod(high - low) / MAX_NODES)))
        origin = cell * np.floor(low / cell)
        n_x, n_y = (np.ceil((high - origin) / cell).astype(int) + 1).tolist()
        node = cell * np.indices((n_y, n_x))[::-1].reshape(2, -1).T
        square = ((node[:, None] - node[None]) ** 2).sum(axis=-1)
        size, way = np.linalg.eigh(DEVIATION**2 * np.exp(-0.5 * square / LENGTH**2))
        kept = size > SMALLEST * size.max()
        return cls(origin, cell, (n_y, n_x), way[:, kept] * np.sqrt(size[kept]))

    def weights(self, places: FloatArray) -> scipy.sparse.csr_array:
        """Return the weights (k, n_node) of the nodes at places (k, 2)."""
        n_y, n_x = self.shape
        at = np.clip((places - self.origin) / self.cell, 0.0, [n_x - 1.001, n_y - 1.001])
        node = at.astype(int)
        part = at - node
        corner = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])[:, None]
        column = (node + corner) @ [1, n_x]
        weight = np.where(corner, part, 1.0 - part).prod(axis=2)
        row = np.tile(np.arange(len(places)), 4)
        shape = len(places), n_y * n_x
        return scipy.sparse.csr_array((weight.ravel(), (row, column.ravel())), shape=shape)

    def levelled(self, field: FloatArray, places: FloatArray) -> FloatArray:
        """Take the constant and the plane about places (k, 2) from fields (n_node, ...).

        No push depends on these.
        """
        node = np.indices(self.shape)[::-1].reshape(2, -1).T
        plane = np.column_stack((np.ones(len(node)), node))
        counted = plane * np.asarray(self.weights(places).sum(axis=0)).reshape(-1, 1)
        return np.asarray(field - plane @ np.linalg.solve(counted.T @ plane, counted.T @ field))

    def load_map(self, field: FloatArray) -> LoadMap:
        """Return values (n_node,) of the nodes as a map."""
        values = field.reshape(self.shape)
        return LoadMap(origin=self.origin, cell=np.full(2, self.cell), log_load=values)


class MapRows(NamedTuple):
    """Derivatives of the ends of a part's pushes."""

    by_map: FloatArray  # (n, 3, m) in standard deviations of the prior
    by_load: FloatArray  # (n, 3, p) by log loads
    by_balanced: FloatArray  # (n, 3, p) by log loads that are then balanced
    by_value: FloatArray  # (n, 3, q) by `CORRECTED`, in standard deviations
    pose: FloatArray  # (n, 3) of the part half way
    residual: FloatArray  # (n, 3) [m]
    good: BoolArray  # (n,)

    @classmethod
    def of(cls, part: StandingPart, grid: MapGrid) -> MapRows:
        """Return the rows of all pushes of a part."""
        n, p = part.places.shape[:2]
        factor = np.asarray(grid.weights(part.places.reshape(-1, 2)) @ grid.root).reshape(n, p, -1)
        sizes = np.array([sd for sd, _ in CORRECTED.values()])
        return cls(
            part.by_load @ part.balanced(factor),
            part.by_load,
            part.by_load @ part.balanced(np.broadcast_to(np.eye(p), (n, p, p))),
            part.by_value * sizes,
            part.middle,
            part.residual,
            part.good,
        )

    def rows(self, which: IntArray) -> MapRows:
        """Return the rows of some of the pushes."""
        return MapRows._make(array[which] for array in self)

    def usable(self) -> MapRows:
        """Return the rows of pushes that ended, at most `MAX_ROWS`."""
        found = np.flatnonzero(self.good)
        if len(found) > MAX_ROWS:
            found = np.sort(np.random.default_rng(0).permutation(found)[:MAX_ROWS])
        return self.rows(found)

    def covariance(self, by_pose: bool) -> FloatArray:
        """Return the covariance (3 n, 3 n) of ends due to what is the part's own [m^2]."""
        free, balanced, value = (
            own.reshape(-1, own.shape[2]) for own in (self.by_load, self.by_balanced, self.by_value)
        )
        if not by_pose:
            return np.asarray(OWN_DEVIATION**2 * balanced @ balanced.T + value @ value.T)
        near = np.kron(likeness(self.pose, self.pose), np.ones((3, 3)))
        own = OWN_DEVIATION**2 + POSE_DEVIATION**2 * near
        found = own * (balanced @ balanced.T) + FRICTION_DEVIATION**2 * near * (free @ free.T)
        return np.asarray(found + value @ value.T)


def likeness(pose: FloatArray, other: FloatArray) -> FloatArray:
    """Return the correlations (n, k) of what changes from pose to pose."""
    away = ((pose[:, None, :2] - other[:, :2]) ** 2).sum(axis=2) / POSE_LENGTH**2
    turn = 2.0 * np.sin(0.5 * (pose[:, None, 2] - other[:, 2])) / POSE_ANGLE
    return np.asarray(np.exp(-0.5 * (away + turn**2)))


class OwnFit(NamedTuple):
    """Corrections of a part's values, and changes of its loads and friction from pose to pose."""

    value: FloatArray  # (q,) in standard deviations
    pose: FloatArray  # (n, 3) of the pushes
    balanced: FloatArray  # (n, p) weights of these, for log loads
    free: FloatArray  # (n, p) the same for the friction at points

    def changes(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return changes (k, p) of log loads and of the logarithm of friction at poses (k, 3)."""
        near = likeness(pose, self.pose)
        load = OWN_DEVIATION**2 + POSE_DEVIATION**2 * near
        return load @ self.balanced, FRICTION_DEVIATION**2 * near @ self.free


class TableFit(NamedTuple):
    """Fitted map in standard normal coordinates of its prior."""

    mean: FloatArray  # (m,)
    factor: FloatArray  # (m, m) square root of the covariance
    # Information of the pushes of each part: precision (m, m) and its product with the mean.
    information: tuple[tuple[FloatArray, FloatArray], ...]
    parts: tuple[MapRows, ...]  # pushes that were used
    force: tuple[FloatArray, ...]  # (n, 3) what is left of the ends over their covariance

    def pusher(self, part: int) -> FloatArray:
        """Return corrections (q,) of `CORRECTED` of a part."""
        change = np.einsum("ni,niq->q", self.force[part], self.parts[part].by_value)
        return np.asarray(change * [sd for sd, _ in CORRECTED.values()])

    def without(self, part: int) -> FloatArray:
        """Return the mean (m,) without the pushes of a part; weights of other pushes stay."""
        others = [own for k, own in enumerate(self.information) if k != part]
        m = len(self.mean)
        precision = sum((own for own, _ in others), np.eye(m))
        return np.asarray(np.linalg.solve(precision, sum((own for _, own in others), np.zeros(m))))


def fit_table(rows: Sequence[MapRows], by_pose: bool = False) -> TableFit:
    """Fit the map and what is the parts' own together, with robust weights of pushes.

    Ends are linear in all, which have normal priors: a Gaussian process whose posterior mean is
    computed part by part, given the map. The noise of the ends is near the median of what is left.
    What is a part's own differs from pose to pose (`by_pose`), but a map that is fitted at the same
    time was worse for other parts.
    """
    parts = [own.usable() for own in rows]
    prior = [part.covariance(by_pose) for part in parts]
    m = parts[0].by_map.shape[2]
    noise = [np.full(len(part.pose), LARGEST_NOISE**2) for part in parts]
    for _ in range(ROUNDS):
        information, solved = [], []
        for part, own, each in zip(parts, prior, noise, strict=True):
            by_map = part.by_map.reshape(3 * len(part.pose), m)
            columns = np.column_stack((by_map, part.residual.reshape(-1)))
            inner = cho_factor(own + np.diag(np.repeat(each, 3)), lower=True)
            solved.append(cho_solve(inner, columns))
            information.append((by_map.T @ solved[-1][:, :m], by_map.T @ solved[-1][:, m]))
        precision = np.eye(m) + sum(own for own, _ in information)
        mean = np.asarray(
            np.linalg.solve(precision, sum(own for _, own in information)), np.float64
        )
        force = [(own[:, m] - own[:, :m] @ mean).reshape(-1, 3) for own in solved]
        left = [e * np.linalg.norm(own, axis=1) for own, e in zip(force, noise, strict=True)]
        sizes = min(np.median(np.concatenate(left)) / MEDIAN, LARGEST_NOISE), LARGEST_NOISE
        size = np.sqrt(np.average(np.square(sizes), weights=(sum(map(len, left)), IMAGINARY)))
        noise = [size**2 * np.sqrt(1.0 + (own / size) ** 2) for own in left]
    factor = np.asarray(np.linalg.inv(np.linalg.cholesky(precision)).T, np.float64)
    return TableFit(mean, factor, tuple(information), tuple(parts), tuple(force))


def own_fit(rows: MapRows, mean: FloatArray) -> OwnFit:
    """Fit what is a part's own, from pose to pose, given the mean (m,) of the map."""
    left = rows._replace(residual=rows.residual - rows.by_map @ mean, by_map=rows.by_map[:, :, :0])
    fit = fit_table([left], by_pose=True)
    part, force = fit.parts[0], fit.force[0]
    balanced, free = (
        np.einsum("ni,nip->np", force, own) for own in (part.by_balanced, part.by_load)
    )
    return OwnFit(np.einsum("ni,niq->q", force, part.by_value), part.pose, balanced, free)


def own_of(part: StandingPart, load_map: LoadMap) -> OwnFit:
    """Fit what is a part's own on a known map."""
    rows = MapRows.of(part, _nodes_of(load_map, np.zeros((load_map.log_load.size, 0))))
    return own_fit(rows._replace(residual=_left_by(part, load_map)), np.zeros(0))


def _nodes_of(load_map: LoadMap, root: FloatArray) -> MapGrid:
    n_y, n_x = load_map.log_load.shape
    return MapGrid(load_map.origin, float(load_map.cell[0]), (n_y, n_x), root)


def _left_by(part: StandingPart, load_map: LoadMap) -> FloatArray:
    """Return what a map leaves of the ends (n, 3) [m]."""
    height = load_map.at(part.places)[:, :, None]
    return np.asarray(part.residual - (part.by_load @ part.balanced(height))[:, :, 0])


# Motions of a table by which its map is differentiated, and their prior [m], [rad].
MOTION: Final = (4e-3, 4e-3, 0.03)
PRIOR_MOTION: Final = np.array([20e-3, 20e-3, 0.15])


def shift_of(
    parts: Sequence[StandingPart], load_map: LoadMap, spread: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Estimate the motion (3,) of a table [m, m, rad] since its map was made, and its deviation.

    The turn is about the centre of the pushes. Parts are corrected at the same time, and the map
    within its own uncertainty: `spread` (n_node, k) is the square root of the covariance of the
    nodes.
    """
    grid = _nodes_of(load_map, spread)
    centre = np.concatenate([part.places.reshape(-1, 2) for part in parts]).mean(axis=0)
    rows = []
    for part in parts:
        away = part.places - centre

        def height(move: FloatArray, away: FloatArray = away) -> FloatArray:
            c, s = np.cos(move[2]), np.sin(move[2])
            back = (away - move[:2]) @ np.array([[c, -s], [s, c]])
            return load_map.at(back + centre)

        steps = np.diag(MOTION)
        slope = [(height(step) - height(-step)) / (2.0 * step.sum()) for step in steps]
        own = MapRows.of(part, grid)
        by_move = part.by_load @ part.balanced(np.stack(slope, axis=-1))
        rows.append(
            own._replace(
                by_map=np.concatenate((by_move * PRIOR_MOTION, own.by_map), axis=2),
                residual=_left_by(part, load_map),
            )
        )
    fit = fit_table(rows)
    deviation = np.linalg.norm(fit.factor[:3], axis=1)
    if len(rows) > 1:
        # How a part touches the table differs from pose to pose, which the fit does not know. Parts
        # that disagree by more than they should show how much it matters.
        alone = [fit_table([own]) for own in rows]
        away = np.array([own.mean[:3] - fit.mean[:3] for own in alone])
        size = np.array([np.linalg.norm(own.factor[:3], axis=1) for own in alone])
        deviation = deviation * np.sqrt(
            np.maximum(1.0, ((away / size) ** 2).sum(axis=0) / (len(rows) - 1))
        )
    return PRIOR_MOTION * fit.mean[:3], PRIOR_MOTION * deviation
