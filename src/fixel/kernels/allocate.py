"""Allocation of problems and workspaces: the only one of a rollout, made before its first
step."""

import numpy as np

from fixel.kernels.arrays import LANE_FIELDS, N_PLACE, N_SIZE, Model, Problem, Workspace
from fixel.kernels.islands import island_room
from fixel.kernels.jit import allocating_kernel
from fixel.kernels.josephy import MAX_CONTACTS, MAX_DRIVES
from fixel.kernels.linear import DENSE_LIMIT
from fixel.kernels.residual import SCRATCH

SPARE = 2  # entries behind the last degree of freedom, so that every block may be read three wide


@allocating_kernel
def empty_problem(n_dof: int, n_contact: int, n_element: int) -> Problem:
    """Allocate a problem with room for these numbers of degrees of freedom, contacts and friction
    elements, none of them in use."""
    wide = n_dof + SPARE
    return Problem(
        size=np.zeros(N_SIZE, np.int64),
        inertia=np.zeros((wide, 3)),
        momentum=np.zeros(wide),
        velocity=np.zeros(wide),
        stiffness=np.zeros(wide),
        contact_dof=np.zeros((n_contact, 2), np.int64),
        contact_key=np.zeros(n_contact, np.int64),
        contact_body=np.zeros((n_contact, 2), np.int64),
        contact_place=np.zeros((n_contact, N_PLACE)),
        normal=np.zeros((n_contact, 6)),
        tangent=np.zeros((n_contact, 6)),
        bias=np.zeros((n_contact, 2)),
        friction=np.zeros(n_contact),
        impulse=np.zeros((n_contact, 2)),
        element_dof=np.zeros(n_element, np.int64),
        element_sides=np.zeros(n_element, np.int64),
        element_row=np.zeros((n_element, 3, 3)),
        element_bias=np.zeros((n_element, 3)),
        element_limit=np.zeros(n_element),
        element_impulse=np.zeros((n_element, 3)),
    )


@allocating_kernel
def empty_workspace(
    n_dof: int,
    n_contact: int,
    n_element: int,
    n_vertex: int,
    n_piece: int,
    n_body: int,
    n_pair: int,
) -> Workspace:
    """Allocate the workspace for a problem and a scene of these sizes."""
    wide = n_dof + SPARE
    n_row = 4 * min(n_contact, MAX_CONTACTS) + 2 * MAX_DRIVES
    # Islands are for large problems only.
    n_float = 0
    n_index = 0
    if n_dof > DENSE_LIMIT:
        n_float, n_index = island_room(wide, n_contact, n_element)
    return Workspace(
        matrix=np.zeros((wide, wide)),
        profile=np.zeros(wide, np.int64),
        active=np.zeros(wide, np.int64),
        right=np.zeros(wide + SCRATCH),
        contact_change=np.zeros((n_contact, 24)),
        element_change=np.zeros((n_element, 21)),
        lanes=np.zeros(LANE_FIELDS * n_element),
        world=np.zeros((n_vertex, 2)),
        is_placed=np.zeros(n_piece, np.int64),
        frame=np.zeros((n_body, 4)),
        old_key=np.zeros(n_contact, np.int64),
        old_impulse=np.zeros((n_contact, 4)),
        near=np.zeros((n_pair, 2), np.int64),
        order=np.arange(n_piece),
        extent=np.zeros((n_piece, 3)),
        anchor=np.zeros((n_body, 3)),
        reach=np.zeros(1),
        inverse=np.zeros((wide, 3)),
        pull=np.zeros(wide),
        centre=np.zeros(wide),
        search=np.zeros((wide, 5)),
        tableau=np.zeros((n_row, 2 * n_row + 2)),
        basis=np.zeros(n_row),
        island_floats=np.zeros(n_float),
        island_indices=np.zeros(n_index, np.int64),
        near_count=np.full(1, -1, np.int64),
    )


@allocating_kernel
def allocate(model: Model, max_contacts: int) -> tuple[Problem, Workspace]:
    """Allocate a problem and a workspace large enough for every step of a rollout."""
    n_free = model.mass.size
    n_driven = model.force_limit.size
    n_body = model.friction.shape[0]
    n_piece = model.piece_body.size
    n_dof = 3 * n_free
    for d in range(n_driven):
        if model.drive_dof[d] >= 0:
            n_dof += 1
    n_pair = 0
    others = 0  # pieces of later bodies
    for i in range(n_piece - 1, -1, -1):
        if i + 1 < n_piece and model.piece_body[i + 1] != model.piece_body[i]:
            others = n_piece - i - 1
        if model.piece_body[i] < n_free:
            n_pair += others
    n_pair = min(n_pair, 32 * n_piece)
    n_contact = min(2 * n_pair, max_contacts)
    n_element = model.element_body.size + n_driven
    problem = empty_problem(n_dof, n_contact, n_element)
    work = empty_workspace(
        n_dof, n_contact, n_element, model.vertex.shape[0], n_piece, n_body, n_pair
    )
    return problem, work
