"""Steps of a stored calibration one by one, for tests that interrupt or inspect it between them."""

from dataclasses import replace

from tests.fixtures import project_of

from fixel.calibration.usual_parameters import searched_unknowns
from fixel.model.selection import ExperimentQuery
from fixel.workflows import jobs
from fixel.workflows.calibration import calibration
from fixel.workflows.calibration.execution import (
    ExperimentSelection,
    draw_sample,
    select_experiments,
)
from fixel.workflows.calibration.plan import CalibrationPlan, plan_in
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions, options_of
from fixel.workflows.calibration.stored import add_to_project
from fixel.workflows.capabilities import CAPABILITIES, prepare as prepare_job

__all__ = ["ExperimentSelection", "draw_sample", "select_experiments"]


def collected(project, folder):
    """Return the calibrations of a finished job in a project, as the page stores them."""
    return add_to_project(project, calibration.collect(plan_in(folder), folder))


def prepare(project, chosen, request):
    """Prepare the job of a request on selected experiments; return its folder."""
    request.check()
    plan = CalibrationPlan(request=request, targets=chosen.targets).rehearse()
    asked = CAPABILITIES["calibrate"].request(options_of(request, chosen.ids))
    return prepare_job(CAPABILITIES["calibrate"], asked, project, plan.inputs)


def run(folder, progress=None):
    """Run a job in this process, or continue it."""
    if jobs.status_of(folder).state != "done":
        jobs.arrange(folder)
        jobs.run_here(folder, progress)


def collect(project, folder, command, left_out):
    """Return what a job has stored; a second call stores nothing."""
    plan = replace(plan_in(folder), left_out=left_out)
    found = calibration.collect(plan, folder)
    return add_to_project(project, replace(found, command=command))


def calibrated(folder, experiments, fit, command="test", **request):
    """Create a project with these experiments, roughly calibrated by a search for patterns."""
    project = project_of(folder, experiments)
    with project.store() as store:
        chosen = select_experiments(store, (), ExperimentQuery())
    unknowns = searched_unknowns(fit, [target.case.scene for target in chosen.targets])
    rough = NamedOptions(name="pattern-search", options={"threshold_delta": 0.2})
    made = CalibrationRequest(unknowns=unknowns, optimiser=rough, verdicts=False, **request)
    done(project, chosen, made, command)
    return project


def done(project, chosen, request, command="test"):
    """Prepare, run and store the calibration of a request."""
    folder = prepare(project, chosen, request)
    run(folder)
    return collect(project, folder, command, {})


def alone(run):
    """Return the sets of a run for single experiments."""
    return [one for one in run.outcome.found if one.how.is_single]


def together(run):
    """Return the sets of a run for all experiments together."""
    return [one for one in run.outcome.found if not one.how.is_single]
