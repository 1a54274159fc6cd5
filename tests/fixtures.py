"""Projects for tests of all rooms: built once for each module, or for each test that writes."""

from dataclasses import replace

from fixel.database.project import Project
from fixel.sampling.published import thesis_plan


def project_of(folder, experiments):
    """Create a project with these experiments, whose ids count from 1."""
    project = Project.create(folder)
    with project.store() as store:
        for experiment in experiments:
            store.add_experiment(experiment)
    return project


def short_plan(name="few", *, repetitions=2, speed=0.06):
    """The plan of the thesis with one configuration of a square, and strokes of 120 mm."""
    plan = thesis_plan()
    return replace(
        plan,
        name=name,
        shapes=plan.shapes[:1],
        layouts=plan.layouts[:1],
        schemes=plan.schemes[:1],
        repetitions=repetitions,
        rig=replace(plan.rig, speed=speed, travel=0.12),
    )
