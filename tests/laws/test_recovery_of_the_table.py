"""Bends of a table that made pushes are found again from pushes at several angles."""

import numpy as np
import pytest

from fixel.calibration.assess import Frames
from fixel.calibration.least_squares import LeastSquares, fit
from fixel.calibration.noise import Noise
from fixel.calibration.objective import Comparer
from fixel.calibration.study import box_of
from fixel.calibration.target import Target
from fixel.model import Body, Disk, PathDrive, Pusher, Scene, SupportPoints
from fixel.model.space import ParameterSpace, Unknown
from fixel.model.support import support_grid
from fixel.simulation.ensemble import Ensemble
from fixel.simulation.rollouts import RolloutCase
from fixel.testing.scenes import box
from fixel.typing import FloatArray

PLATE = box(0.09, 0.06)
RADIUS = 5e-3
# One board is warped more than the other; all else they share.
BOARDS = {"plywood": -1.1, "abs": 0.2}
SHARED = {
    "table_bend": 0.4, "table_bend_diagonal": 0.5, "table_slope_x": 0.3, "table_slope_y": -0.2,
}  # fmt: skip


def unknown(name: str, **changes: object) -> Unknown:
    return Unknown(name=name, low=-2.0, high=2.0, nominal=0.0, **changes)


SPACE = ParameterSpace(
    unknowns=(
        *(unknown("table_bend_xy", where={"surface": board}) for board in BOARDS),
        *(unknown(name) for name in SHARED),
    )
)
TRUTH = [*BOARDS.values(), *SHARED.values()]
TIMES = np.linspace(1.0, 4.0, 4)


def push(angle: float, aside: float) -> RolloutCase:
    """40 mm against the long side of the plate, so far from its middle."""
    along = np.array([-np.sin(angle), np.cos(angle)])
    across = np.array([np.cos(angle), np.sin(angle)])
    begin = aside * across - (0.03 + RADIUS) * along
    end = begin + 0.04 * along
    path: FloatArray = np.array([[0.0, *begin, 0.0], [4.0, *end, 0.0]])
    body = Body(
        name="plate",
        shape=PLATE,
        mass=0.8,
        pose=(0.0, 0.0, angle),
        support=SupportPoints(points=support_grid(PLATE)[0], friction=0.3),
    )
    tip = Pusher(
        name="tip",
        shape=Disk(RADIUS),
        pose=path[0, 1:],
        drive=PathDrive(waypoints=path),
        friction=0.2,
    )
    return RolloutCase(Scene(bodies=(body,), pushers=(tip,), duration=4.0), TIMES)


@pytest.fixture(scope="module")
def targets() -> list[Target]:
    cases = [push(angle, aside) for angle in np.arange(6.0) for aside in (-0.02, 0.012)]
    boards = [list(BOARDS)[k % 4 // 2] for k in range(len(cases))]
    values = {name: np.full(len(cases), value) for name, value in SHARED.items()}
    values["table_bend_xy"] = np.array([BOARDS[board] for board in boards])
    outcome = Ensemble(cases).simulate(np.arange(len(cases)), values)
    assert outcome.converged.all()
    return [
        Target(f"push {k}", {"surface": boards[k]}, case, outcome.pose[k])
        for k, case in enumerate(cases)
    ]


def test_bends_come_back(targets: list[Target]) -> None:
    frames = Frames(Comparer(targets, SPACE), np.arange(len(targets)))
    noise = Noise(position_m=1e-3, angle_rad=1 / 35, source="stated")

    found = fit(LeastSquares().start(box_of(SPACE)), frames.residuals(noise))

    assert found.point == pytest.approx(TRUTH, abs=1e-3)
