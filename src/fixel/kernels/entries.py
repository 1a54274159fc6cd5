"""Entries for the plain Python loop and for tests: the parts of one step as functions."""

from typing import Any

from fixel.kernels import assembly, residual, rollout, samples, solve, step, step_control
from fixel.kernels.arrays import Problem, Workspace
from fixel.kernels.jit import entry
from fixel.kernels.lemke import allocate_tableau
from fixel.kernels.linear_form import ENOUGH, solve_linear_form, tableau_size
from fixel.kernels.rollout import empty_problem, empty_workspace


def _entry(helper: Any) -> Any:
    """Compile a helper again, as a function that Python calls."""
    return entry(getattr(helper, "py_func", helper))


allocate = _entry(rollout.allocate)
begin = _entry(rollout.begin)
contacts = _entry(step.prepare_contacts)
assemble = _entry(step.prepare_bodies)
rows = _entry(step.prepare_rows)
set_stiffness = _entry(assembly.set_stiffness)
solve_problem = _entry(solve.solve)
judge = _entry(residual.residual)
may_jam = _entry(solve.may_jam)
gains_energy = _entry(step.creates_energy)
leave_overlaps = _entry(step.leave_overlaps)
keep_impulses = _entry(step.keep_impulses)
move_bodies = _entry(step.move)
write_samples = _entry(samples.write_samples)
begin_control = _entry(step_control.begin_control)
limit_step = _entry(step_control.limit_step)
start_trial = _entry(step_control.start_trial)
choose_trial = _entry(step_control.choose_trial)
predict_velocity = _entry(step_control.predict_velocity)
judge_step = _entry(step_control.judge_step)
event_time = _entry(step_control.event_time)
parts = _entry(step_control.parts)
rests = _entry(step_control.rests)
end_at_rest = _entry(step_control.end_at_rest)
is_thrown = _entry(step_control.is_thrown)
bounces = _entry(step_control.bounces)
extrapolation = _entry(step_control.extrapolation)
end_step = _entry(step_control.end_step)
take_back = _entry(step_control.take_back)


@entry
def empty(
    n_dof: int,
    n_contact: int,
    n_element: int,
    n_vertex: int,
    n_piece: int,
    n_body: int,
    n_pair: int,
) -> tuple[Problem, Workspace]:
    """See `rollout.empty_problem` and `rollout.empty_workspace`."""
    work = empty_workspace(n_dof, n_contact, n_element, n_vertex, n_piece, n_body, n_pair)
    return empty_problem(n_dof, n_contact, n_element), work


@entry
def solve_by_pivoting(problem: Problem, work: Workspace, max_pivots: int) -> float:
    """Solve a step by `linear_form.solve_linear_form`; returns the natural-map residual.

    Returns the residual of the guess where `max_pivots` is too small for the number of rows.
    """
    n_row = tableau_size(problem, 0)
    if ENOUGH * n_row <= max_pivots:
        solve_linear_form(problem, work, allocate_tableau(max(0, n_row)), 0, max_pivots)
    return residual.residual(problem, work.right)
