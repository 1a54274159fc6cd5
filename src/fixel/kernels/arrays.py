"""NamedTuples of arrays that Python passes to the kernels.

`Model` is constant during a rollout, `State` changes from step to step, `Problem` is the mixed
complementarity problem of one step, `Workspace` is scratch. All arrays are C-ordered float64 or
int64, in scaled units (length, mass and time in units of the scene's characteristic values).
Absent data are arrays of length zero, never None.

Bodies are numbered free first, then driven, then fixed. Degrees of freedom are numbered three for
each free body (vx, vy, omega at its centre of mass), then one for each driven body (its speed
along its path). Arrays indexed by degree of freedom carry two spare entries at the end, so that
every block may be read and written three wide.
"""

from typing import NamedTuple

from fixel.typing import FloatArray, IntArray


class Model(NamedTuple):
    """Quantities that are constant during a rollout."""

    mass: FloatArray  # (n_free,)
    inertia: FloatArray  # (n_free,) about the centre of mass
    wrench: FloatArray  # (n_free, 3) constant applied wrench, world axes
    spring: FloatArray  # (n_free, 3) stiffness, anchor x, anchor y
    drag: FloatArray  # (n_free, 3, 3) first-order model: wrench per twist, body axes
    piece_body: IntArray  # (n_piece,) body that owns the convex piece
    piece_start: IntArray  # (n_piece + 1,) piece i owns vertex[piece_start[i]:piece_start[i + 1]]
    piece_bound: FloatArray  # (n_piece, 3) bounding circle: centre x, y in the body frame, radius
    piece_radius: FloatArray  # (n_piece,) rounding radius; a disk is one vertex with a radius
    vertex: FloatArray  # (n_vertex, 2) body frame, counter-clockwise
    edge_real: IntArray  # (n_vertex,) 1 where the edge from this vertex has contacts
    friction: FloatArray  # (n_body, n_body) of each pair
    restitution: FloatArray  # (n_body, n_body)
    element_body: IntArray  # (n_element,) free body that rests on the friction element
    element_kind: IntArray  # (n_element,) codes.POINT or codes.ELLIPSOID
    element_point: FloatArray  # (n_element, 2) in the body frame, from the centre of mass
    element_limit: FloatArray  # (n_element,) largest friction force
    element_ratio: FloatArray  # (n_element,) ellipsoid: largest torque over largest force
    path_start: IntArray  # (n_driven + 1,) pusher k owns path[path_start[k]:path_start[k + 1]]
    path: FloatArray  # (n_sample, 4) time, x, y, theta
    force_limit: FloatArray  # (n_driven,) of the drive; inf for a rigid drive
    drive_dof: (
        IntArray  # (n_driven,) degree of freedom of a force-limited drive; -1 for a rigid one
    )
    plane: FloatArray  # (3,) friction factors along the plane's axes, angle of the first axis
    map_frame: FloatArray  # (4,) friction map: origin x, y, cell x, y
    map_factor: FloatArray  # (n_row, n_column) friction map; (0, 0) where there is none
    sides: int  # of the support friction polygon; 0 for the exact disc


class State(NamedTuple):
    """Quantities that change from step to step."""

    pose: FloatArray  # (n_body, 3) of the centre of mass (free) or shape frame (driven, fixed)
    velocity: FloatArray  # (n_dof + 2,)
    # (2 n_driven,) clock of each pusher, which lags behind when its drive stalls; then their slips.
    path_time: FloatArray
    middle: FloatArray  # (n_dof + 2,) velocity at the middle of the last step
    owed: FloatArray  # (1,) time before now for which forces have not changed velocities yet


# Entries of `Problem.size`, the numbers in use.
N_DOF = 0
N_CONTACT = 1
N_ELEMENT = 2
N_FREE_DOF = 3  # degrees of freedom of the free bodies
N_POINT = 4  # of the first elements: points without torque of their own; zero for unknown
N_SIZE = 5
LANE_FIELDS = 18  # numbers of a point in `Workspace.lanes`
# Columns of `Problem.contact_place`.
GAP = 0
NORMAL_X = 1  # into the first body
NORMAL_Y = 2
POINT_X = 3
POINT_Y = 4
OVERLAP = 5  # to take back apart from the velocities
GIVEN_BACK = 6  # part of the bias that is restitution
DRIVEN_NORMAL = 7  # part of the bias that is prescribed motion
HALVINGS = 8  # how often less was given back
# Until the rows are written: radius of either outline, zero for a corner, infinite for an edge.
ROUND_A = 5
ROUND_B = 6
# Distances along its edge from the foot of a vertex to the edge's start and end, which shrink and
# grow with the tangential velocity; infinite for other contacts.
TO_START = 9
TO_END = 10
N_PLACE = 11


class Problem(NamedTuple):
    """The mixed complementarity problem of one step; docs/theory/contact.md gives the equations.

    inertia v - momentum = sum of normal, tangent and element rows times their impulses, 0 <= p_n
    _|_ normal v + normal_bias >= 0, Coulomb on the tangents, maximum dissipation on the elements.
    """

    size: IntArray  # (N_SIZE,) see N_DOF
    inertia: FloatArray  # (n_dof + 2, 3) row of each degree of freedom within its own block
    momentum: FloatArray  # (n_dof + 2,)
    velocity: FloatArray  # (n_dof + 2,) unknown; in: the guess, out: the solution
    stiffness: FloatArray  # (n_dof + 2,) impulse per velocity that the block typically needs
    contact_dof: (
        IntArray  # (n_contact, 2) first degree of freedom of the two bodies, -1 where prescribed
    )
    contact_key: IntArray  # (n_contact,) names the pair of features, the same from step to step
    contact_body: IntArray  # (n_contact, 2)
    contact_place: FloatArray  # (n_contact, N_PLACE) see GAP
    normal: FloatArray  # (n_contact, 6) row of the normal velocity, three columns a body
    tangent: FloatArray  # (n_contact, 6)
    bias: FloatArray  # (n_contact, 2) normal (gap / step and prescribed motion), tangential
    friction: FloatArray  # (n_contact,)
    impulse: FloatArray  # (n_contact, 2) unknown: normal, tangential
    element_dof: IntArray  # (n_element,)
    element_sides: IntArray  # (n_element,) 0: ball; m: polygon of m sides
    element_row: FloatArray  # (n_element, 3, 3) rows of the slip velocity; unused rows are zero
    element_bias: FloatArray  # (n_element, 3)
    element_limit: FloatArray  # (n_element,) largest impulse
    element_impulse: FloatArray  # (n_element, 3) unknown


class Workspace(NamedTuple):
    """Scratch space of one rollout. Few fields: each makes every kernel slower to compile."""

    matrix: FloatArray  # (n_dof + 2, n_dof + 2)
    profile: IntArray  # (n_dof + 2,) one past the last column a row may couple with, border apart
    active: IntArray  # (n_dof + 2,) the same for the constraints that hold in this iteration
    right: FloatArray  # (n_dof + 2 + residual.SCRATCH,)
    contact_change: (
        FloatArray  # (n_contact, 24) of impulse (2), slope, state; given friction limit; sweeps
    )
    element_change: (
        FloatArray  # (n_element, 21) of impulse and how it depends (8); saved impulse; sweeps; of
        # the last step taken
    )
    lanes: FloatArray  # (LANE_FIELDS n_element,) see one_body.py
    world: FloatArray  # (n_vertex, 2) vertices in the world, of pieces that are placed
    is_placed: IntArray  # (n_piece,) 1 where the vertices of a piece are those of the present pose
    frame: FloatArray  # (n_body, 4) cosine and sine of the angle, x and y of each body
    old_key: IntArray  # (n_contact,) of the last step taken
    old_impulse: (
        FloatArray  # (n_contact, 4) of the last step taken (2); in a solver, saved impulses
    )
    near: IntArray  # (n_pair, 2) pairs of pieces close enough to meet soon
    order: IntArray  # (n_piece,) pieces sorted along x
    extent: FloatArray  # (n_piece, 3) circle of each piece in the world
    anchor: FloatArray  # (n_body, 3) poses when the near pairs were found
    reach: FloatArray  # (1,) how far ahead the near pairs look
    inverse: FloatArray  # (n_dof + 2, 3) rows of the inverse inertia of each block
    pull: FloatArray  # (n_dof + 2,) proximal mass
    centre: FloatArray  # (n_dof + 2,) proximal centre
    search: FloatArray  # (n_dof + 2, 5) line search: base, direction; saved velocity; sweeps
    tableau: FloatArray  # (n_row, 2 n_row + 2) of the contacts and drives, in pivoting
    basis: FloatArray  # (n_row,) column that each of its rows represents
    island_floats: FloatArray  # buffers of islands.py, see there; empty for few unknowns
    island_indices: IntArray
    near_count: IntArray  # (1,) near pairs in use; -1 for not found yet


# Entries of the control of the steps, an array of floats; 1 for true. The first are those of
# `Batch.settings`.
DURATION = 0
STEP = 1  # proposed length of the next step; in a batch the fixed or first one
TOLERANCE = 2  # of position, per step of an adaptive stepper
SMALLEST = 3  # lengths of adaptive steps
LARGEST = 4
N_SETTING = 5
ADAPTIVE = 5  # whether steps are chosen, not fixed
INERTIAL = 6  # whether the motion model is the dynamic one
STAGGERED = 7  # whether forces act up to the middle of a step before its velocity is solved for
ELASTIC = 8  # whether contacts may give back speed
TIME = 9  # the start of the next step
STEPS = 10  # taken so far
UNDONE = 11  # taken back so far
LAST = 12  # lengths of the last three steps, so that two are known after one is taken back
EARLIER = 13
EARLIEST = 14
TIME_BEFORE = 15  # the start of the last step
EVENTFUL = 16  # whether it is known that something happens where the step begins
CAREFUL = 17  # longest step until CAREFUL_UNTIL, after a step was taken back
CAREFUL_UNTIL = 18
LAST_SPAN = 19  # over which the impulses of the last step taken acted; zero for none
# Of the step at hand.
LEFT = 20  # time to the end, or to where a pusher's command changes
TRIAL = 21  # length that is tried
GUESSED = 22  # where the expected velocity comes from
PREDICTING = 23  # whether it has to be computed
RATE = 24  # how far along the line of the last two velocities it lies; zero for not at all
MIN_GAP = 25  # the step ends where a wider gap closes; infinite for no matter where
GIVE_UP_EARLY = 26  # 1 to give up early, since a shorter step can be tried; 2 to do so at once
UNSOLVED = 27  # trials that no solver could solve, though there was no jam
GROWTH = 28  # most from this step to the next
RESUMED = 29  # the step to go on with after a bounce or a closing gap
LEAD = 30  # from the step's start to where its rows are taken
SPAN = 31  # over which forces act before the velocity that is solved for
RATIO = 32  # of the impulses expected to those of the last step taken; zero to expect none
CLOSING = 33  # when contacts change inside the trial; infinite for never
BOUNCES = 34  # whether a contact of the trial gives back speed
SMOOTH = 35  # whether velocities changed as expected
PARTED = 36  # whether a contact that pressed in the last step has come off in the trial
TAKEN_CONTACTS = 37  # contacts of the last step taken
WEDGED = 38  # whether the last trial left overlaps, with no shorter one to try
N_CONTROL = 39


class StepMethod(NamedTuple):
    """Method of stepping, the same for every rollout of a batch."""

    motion: int  # codes.DYNAMIC, QUASI_STATIC or FIRST_ORDER
    solver: int  # codes.NEWTON or GAUSS_SEIDEL
    adaptive: int  # 1 where the stepper chooses its own step
    lead: float  # where rows are taken, in steps after the start: 0, or 0.5 for the midpoint
    max_steps: int
    max_contacts: int
    effort: int  # most sweeps of Gauss-Seidel


# Entries of `RolloutRecord.count` and `total`.
SAMPLES = 0  # written
CONTACT_ROWS = 1  # written
STEPS_TAKEN = 2
FALLBACKS = 3  # solves that needed one
REACHED = 0  # time
WORST_RESIDUAL = 1
STOP = 2  # in: set above 0 by another thread to end the rollout at its next step
LAST_CONTACTS = 3  # in: above 0 to record the contacts of the last sample only
N_TOTAL = 4


class RolloutRecord(NamedTuple):
    """Samples and counts of a rollout."""

    time: FloatArray  # (n_sample,) in: when to sample; out where `every_step`: when a step ended
    pose: FloatArray  # (n_sample, n_moving, 3)
    twist: FloatArray  # (n_sample, n_moving, 3)
    drive: FloatArray  # (n_sample, n_driven, 2) force along the path, 1 where stalled
    contact: (
        FloatArray  # (n_row, 11) sample, two bodies, gap, normal (2), point (2), forces (2), step
    )
    count: IntArray  # type: ignore[assignment]  # (4,) zeros at first; see SAMPLES
    total: FloatArray  # (N_TOTAL,) zeros at first; see REACHED


# Families of a batch: arrays with common first rows.
FREE = 0  # mass, inertia, wrench, spring, drag, velocity
BODY = 1  # pose
PAIR = 2  # friction, restitution
PIECE = 3  # piece_body, piece_bound, piece_radius
PIECE_START = 4  # piece_start
VERTEX = 5  # vertex, edge_real
ELEMENT = 6  # element_*
DRIVEN = 7  # force_limit, drive_dof
PATH_START = 8  # path_start
PATH = 9  # path
MAP = 10  # map_factor
N_FAMILY = 11


class Batch(NamedTuple):
    """Many rollouts: the concatenated arrays of their models, and the first rows of each rollout.

    Rollouts may share rows (one shape, many parameters). Indices stored in the rows
    (`piece_body`, `piece_start`, `path_start`, `element_body`, `drive_dof`) count from each
    rollout's own first row.
    """

    begin: IntArray  # (n_rollout, N_FAMILY) first row of each family
    count: IntArray  # type: ignore[assignment]  # (n_rollout, N_FAMILY) rows of each family
    model: (
        Model  # friction, restitution and map_factor flattened; plane, map_frame: a row per rollout
    )
    map_shape: IntArray  # (n_rollout, 2)
    sides: IntArray  # (n_rollout,)
    pose: FloatArray  # (body rows, 3) at time zero
    velocity: FloatArray  # (free rows, 3) at time zero
    settings: FloatArray  # (n_rollout, N_SETTING) see DURATION


class BatchRecord(NamedTuple):
    """Samples and counts of a batch of rollouts: a stacked `RolloutRecord` of each."""

    time: FloatArray  # (n_rollout, n_sample)
    pose: FloatArray  # (n_rollout, n_sample, n_moving, 3)
    twist: FloatArray  # (n_rollout, n_sample, n_moving, 3)
    drive: FloatArray  # (n_rollout, n_sample, n_driven, 2)
    contact: FloatArray  # (n_rollout, n_row, 11)
    count: IntArray  # type: ignore[assignment]  # (n_rollout, 4)
    total: FloatArray  # (n_rollout, N_TOTAL)
    status: IntArray  # (n_rollout,)
