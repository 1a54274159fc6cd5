"""Small campaigns with calibrations, for tests of the growth of domains."""

from importlib.metadata import version

import numpy as np
from tests.fixtures import calibration_record

from fixel.calibration.objective import Comparer, MeanSquare
from fixel.calibration.target import target_of
from fixel.database.project import Project
from fixel.model import Provenance
from fixel.model.space import ParameterSpace, Unknown
from fixel.sampling.published import thesis_plan
from fixel.simulation import QuasiStatic
from fixel.testbed.simulated import SimulatedTestbed
from fixel.workflows.growth.explore import explore
from fixel.workflows.growth.run import GROWTH

NAMES = ("mu_pusher", "tripod_radius")
METHOD = {
    "how": "alone",
    "mode": "each",
    "error": "mean-square",
    "error_unit": "mm^2",
    "error.angle_scale": 0.035,
    "motion": "quasistatic",
}


def planned(shape="square", layouts=("collinear-tight",)):
    """Experiments of the thesis's plan."""
    return [
        one
        for one in thesis_plan().experiments
        if one.conditions["shape"] == shape and one.conditions["layout"] in layouts
    ]


def performed(plan):
    """Seen by a bench without noise, but with another friction than the scenes say."""
    return list(SimulatedTestbed.ideal().run(plan))


def comparer_of(experiments):
    space = ParameterSpace(
        unknowns=(
            Unknown(name="mu_pusher", low=0.0, high=1.0, nominal=0.3),
            Unknown(name="tripod_radius", low=0.01, high=0.06, nominal=0.03),
        )
    )
    targets = [target_of(experiment) for experiment in experiments]
    return Comparer(targets, space, MeanSquare(), QuasiStatic())


def made_up_points(n, seed=0):
    """A set of parameters an experiment, such as calibrations might have found."""
    draw = np.random.default_rng(seed)
    return np.column_stack((draw.uniform(0.05, 0.4, n), draw.uniform(0.025, 0.055, n)))


def record(members, values, errors, **method):
    own = dict(zip(members, errors, strict=True))
    origin = Provenance(version=version("fixel"))
    return calibration_record(own, values, provenance=origin, method=METHOD | method)


def explored(store, **options):
    return explore(store, GROWTH.request(options))


def project_with(folder, experiments, points=None, errors=None):
    """A project of experiments, each with a calibration if there are points."""
    made = Project.create(folder)
    with made.store() as store:
        ids = [store.add_experiment(experiment).id for experiment in experiments]
        if points is not None:
            for number, point, error in zip(ids, points, errors, strict=True):
                values = dict(zip(NAMES, point.tolist(), strict=True))
                store.add_calibration(record([number], values, [float(error)]))
    return made, ids
