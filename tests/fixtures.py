"""Projects and refusals for tests of all rooms."""

from dataclasses import replace

import numpy as np
import pytest

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.model import Experiment, Parameters, Provenance, Trajectory
from fixel.model.records import CalibrationRecord, Member
from fixel.sampling.published import thesis_plan


def project_of(folder, experiments):
    """Create a project with these experiments, whose ids count from 1."""
    project = Project.create(folder)
    with project.store() as store:
        for experiment in experiments:
            store.add_experiment(experiment)
    return project


def bare_experiment(name, **more):
    """Return an experiment without a scene, of a part that rests for a second."""
    usual = {
        "dataset": "bare",
        "real": True,
        "provenance": Provenance(version="0"),
        "trajectory": Trajectory(time=[0.0, 1.0], pose=np.zeros((2, 3))),
    }
    return Experiment(name=name, **usual | more)


def calibration_record(members, values=(), **more):
    """Return a made-up calibration of members, which are errors [mm^2] by ids of experiments."""
    usual = {
        "name": "made up",
        "parameters": Parameters(values),
        "members": tuple(Member(number, 1.0, error) for number, error in members.items()),
        "provenance": Provenance(version="0"),
    }
    return CalibrationRecord(**usual | more)


def short_plan(name="few", *, repetitions=2, speed=0.06):
    """The plan of the thesis with one configuration of a square, and strokes of 0.1 m.

    The head meets the part after 36 mm, and jams after 40 mm where it does; the part has met its
    fixels after 60 mm.
    """
    plan = thesis_plan()
    return replace(
        plan,
        name=name,
        shapes=plan.shapes[:1],
        layouts=plan.layouts[:1],
        schemes=plan.schemes[:1],
        repetitions=repetitions,
        rig=replace(plan.rig, speed=speed, travel=0.1),
    )


def refused(call, *arguments, match=None, **options):
    """Return the `InvalidInput` that a call must raise, with these words."""
    with pytest.raises(InvalidInput, match=match) as refusal:
        call(*arguments, **options)
    return refusal.value
