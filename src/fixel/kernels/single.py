"""Entries for the plain Python loop and for tests: the parts of one step as functions."""

from fixel.kernels import assembly as _assembly
from fixel.kernels import rollout as _rollout
from fixel.kernels.allocate import empty_problem, empty_workspace
from fixel.kernels.arrays import Model, Problem, RolloutRecord, State, Workspace
from fixel.kernels.feasible import squeezed
from fixel.kernels.jit import entry
from fixel.kernels.lemke import allocate_tableau
from fixel.kernels.linear_form import ENOUGH, solve_linear_form, tableau_size
from fixel.kernels.residual import residual
from fixel.kernels.solve import locked, solve
from fixel.kernels.step import creates_energy, move, prepare_bodies, prepare_contacts, prepare_rows
from fixel.typing import FloatArray


@entry
def allocate(model: Model, max_contacts: int) -> tuple[Problem, Workspace]:
    """See `rollout.allocate`."""
    return _rollout.allocate(model, max_contacts)


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
    """See `allocate.empty_problem` and `allocate.empty_workspace`."""
    work = empty_workspace(n_dof, n_contact, n_element, n_vertex, n_piece, n_body, n_pair)
    return empty_problem(n_dof, n_contact, n_element), work


@entry
def set_stiffness(problem: Problem, n_element: int) -> None:
    """See `assembly.set_stiffness`."""
    _assembly.set_stiffness(problem, n_element)


@entry
def begin(
    model: Model,
    state: State,
    velocity: FloatArray,
    step: float,
    problem: Problem,
    work: Workspace,
) -> None:
    """See `rollout.begin`."""
    _rollout.begin(model, state, velocity, step, problem, work)


@entry
def contacts(
    model: Model,
    state: State,
    time: float,
    step: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    work: Workspace,
    ratio: float,
) -> bool:
    """See `step.prepare_contacts`."""
    return prepare_contacts(model, state, time, step, lead, guess, pose, problem, work, ratio)


@entry
def assemble(
    model: Model, state: State, motion: int, span: float, pose: FloatArray, problem: Problem
) -> int:
    """See `step.prepare_bodies`."""
    return prepare_bodies(model, state, motion, span, pose, problem)


@entry
def rows(
    model: Model,
    state: State,
    motion: int,
    time: float,
    step: float,
    span: float,
    lead: float,
    guess: FloatArray,
    pose: FloatArray,
    problem: Problem,
    n_support: int,
    ratio: float,
) -> None:
    """See `step.prepare_rows`."""
    prepare_rows(
        model, state, motion, time, step, span, lead, guess, pose, problem, n_support, ratio
    )


@entry
def solve_problem(
    problem: Problem, work: Workspace, guess: FloatArray, solver: int, effort: int, trials: int
) -> tuple[float, int]:
    """See `solve.solve`."""
    return solve(problem, work, guess, solver, effort, trials)


@entry
def solve_by_pivoting(problem: Problem, work: Workspace, max_pivots: int) -> float:
    """Solve a step by `linear_form.solve_linear_form`; returns the natural-map residual.

    Returns the residual of the guess where `max_pivots` is too small for the number of rows.
    """
    rows = tableau_size(problem, 0)
    if ENOUGH * rows <= max_pivots:
        solve_linear_form(problem, work, allocate_tableau(max(0, rows)), 0, max_pivots)
    return residual(problem, work.right)


@entry
def judge(problem: Problem, left_over: FloatArray) -> float:
    """See `residual.residual`."""
    return residual(problem, left_over)


@entry
def is_proven_unsolvable(problem: Problem, work: Workspace) -> bool:
    """See `feasible.squeezed`, without friction."""
    return squeezed(problem, work, False)


@entry
def has_no_solution(problem: Problem, work: Workspace, guess: FloatArray) -> bool:
    """See `solve.locked`."""
    return locked(problem, work, guess)


@entry
def gains_energy(model: Model, state: State, problem: Problem) -> bool:
    """See `step.creates_energy`."""
    return creates_energy(model, state, problem)


@entry
def move_bodies(model: Model, state: State, step: float, problem: Problem, ahead: int) -> None:
    """See `step.move`."""
    move(model, state, step, problem, ahead)


@entry
def bounces(
    model: Model, state: State, motion: int, time: float, step: float, problem: Problem
) -> bool:
    """See `rollout.bounces`."""
    return _rollout.bounces(model, state, motion, time, step, problem)


@entry
def time_to_corner(
    model: Model, state: State, time: float, step: float, left: float, slack: float
) -> float:
    """See `rollout.time_to_corner`."""
    return _rollout.time_to_corner(model, state, time, step, left, slack)


@entry
def predict(
    velocity: FloatArray,
    before: FloatArray,
    n_dof: int,
    step: float,
    last: float,
    earlier: float,
    guess: FloatArray,
) -> float:
    """See `rollout.predict`."""
    return _rollout.predict(velocity, before, n_dof, step, last, earlier, guess)


@entry
def largest_change(problem: Problem, guess: FloatArray) -> float:
    """See `rollout.largest_change`."""
    return _rollout.largest_change(problem, guess)


@entry
def largest_speed(problem: Problem) -> float:
    """See `rollout.largest_speed`."""
    return _rollout.largest_speed(problem)


@entry
def is_thrown(model: Model, state: State, time: float, step: float, problem: Problem) -> bool:
    """See `rollout.is_thrown`."""
    return _rollout.is_thrown(model, state, time, step, problem)


@entry
def untouched_change(problem: Problem, guess: FloatArray) -> float:
    """See `rollout.untouched_change`."""
    return _rollout.untouched_change(problem, guess)


@entry
def forced_change(problem: Problem, before: FloatArray) -> float:
    """See `rollout.forced_change`."""
    return _rollout.forced_change(problem, before)


@entry
def closing_time(
    problem: Problem, guess: FloatArray, step: float, lead: float, least: float
) -> float:
    """See `rollout.closing_time`."""
    return _rollout.closing_time(problem, guess, step, lead, least)


@entry
def sample(
    model: Model,
    before: State,
    state: State,
    from_time: float,
    to_time: float,
    span: float,
    problem: Problem,
    record: RolloutRecord,
    every_step: bool,
    duration: float,
) -> int:
    """See `rollout.write_samples`."""
    return _rollout.write_samples(
        model, before, state, from_time, to_time, span, problem, record, 0, every_step, duration
    )
