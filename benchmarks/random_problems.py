"""Random step problems that resemble those of simulations and always have a solution.

Every problem is a function of its seed alone. A velocity v* is drawn first. Every contact is given
a bias such that at v* it opens faster than friction could close it, ``u_n >= mu |u_t|``. This
bounds the impulses of every solution of every Coulomb problem with these rows. Therefore a
solution exists: for positive inertia by copositivity (Stewart & Trinkle 1996), without inertia by
Kakutani's theorem on the friction bounds. Three conditions would violate existence and are never
drawn:

- a rigid drive that squeezes bodies, so that there is no v*;
- in a quasi-static problem, an applied wrench above what the support can hold;
- in a quasi-static problem, contacts with no room at v* (``u_n = mu |u_t|``) that slip there:
  impulses may grow without bound. Contacts without room move along, ``u_n = u_t = 0``.
"""

import math

import numpy as np

from fixel.kernels import entries
from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, Problem, Workspace
from fixel.kernels.assembly import set_stiffness
from fixel.kernels.codes import DYNAMIC, FIRST_ORDER, QUASI_STATIC
from fixel.kernels.jit import allocating_kernel, entry, kernel
from fixel.kernels.rollout import empty_problem, empty_workspace
from fixel.kernels.solve import MAX_ATTEMPTS, TOLERANCE
from fixel.typing import FloatArray, IntArray

MAX_BODIES = 6
MAX_CONTACTS = 12
MAX_DRIVES = 2
MAX_DOF = 3 * MAX_BODIES + MAX_DRIVES
MAX_ELEMENTS = 3 * MAX_BODIES + MAX_DRIVES


@kernel
def _uniform(state: IntArray) -> float:
    """Next random number in [0, 1), by splitmix64 on int64, which wraps in compiled code."""
    state[0] += -7046029254386353131
    z = np.uint64(state[0])
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel
def _between(state: IntArray, low: float, high: float) -> float:
    return low + (high - low) * _uniform(state)


@kernel
def _spread(state: IntArray, low: float, high: float) -> float:
    """Next number between two positive ones, uniform in the logarithm."""
    return math.exp(_between(state, math.log(low), math.log(high)))


@kernel
def _whole(state: IntArray, low: int, high: int) -> int:
    return low + int(_uniform(state) * (high - low + 1))


@kernel
def fill(
    problem: Problem, aim: FloatArray, place: FloatArray, random: IntArray, seed: int
) -> tuple[int, int]:
    """Draw problem `seed` with zero impulses; return its motion, and 1 if it is degenerate.

    `aim` becomes v*, `place` (MAX_BODIES, 2) the centres of mass.
    """
    random[0] = seed * 1000003 + 12345
    for _ in range(3):
        _uniform(random)
    n_body = _whole(random, 1, MAX_BODIES if _uniform(random) < 0.5 else 2)
    n_drive = _whole(random, 0, MAX_DRIVES) if _uniform(random) < 0.5 else 0
    n_contact = _whole(random, 1, MAX_CONTACTS if n_body > 1 else 6)
    motion = _whole(random, 0, 2)
    degenerate = 1 if _uniform(random) < 0.1 else 0
    kind = _whole(random, 0, 5)  # kind of degeneracy
    smooth = degenerate == 1 and kind == 2
    collinear = degenerate == 1 and kind == 1
    heavy = degenerate == 1 and kind == 3
    snug = degenerate == 1 and kind == 4
    twins = degenerate == 1 and kind == 0
    strength = _spread(random, 1e-3, 10.0)
    problem.size[N_DOF] = 3 * n_body + n_drive
    problem.size[N_CONTACT] = n_contact
    problem.size[N_FREE_DOF] = 3 * n_body
    _draw_motion(problem, aim, place, random, n_body, n_drive)
    _draw_bodies(problem, random, motion, strength, n_body, heavy)
    n_support = 0
    if motion != FIRST_ORDER:
        n_support = _draw_supports(problem, random, strength, n_body, collinear, motion)
    problem.size[N_ELEMENT] = n_support + n_drive
    _draw_drives(problem, aim, random, strength, n_support, n_drive)
    set_stiffness(problem, n_support)
    for i in range(n_contact):
        if twins and i > 0 and _uniform(random) < 0.5:
            _copy_contact(problem, _whole(random, 0, i - 1), i)
            continue
        _draw_contact(problem, place, random, i, n_body, n_drive)
        mu = 0.0 if smooth or _uniform(random) < 0.05 else _between(random, 0.0, 1.2)
        problem.friction[i] = mu
        _draw_room(problem, aim, random, i, snug)
    _clear(problem)
    return motion, degenerate


@kernel
def _clear(problem: Problem) -> None:
    for i in range(problem.impulse.shape[0]):
        problem.impulse[i, 0] = 0.0
        problem.impulse[i, 1] = 0.0
    for e in range(problem.element_impulse.shape[0]):
        for k in range(3):
            problem.element_impulse[e, k] = 0.0


@kernel
def _draw_motion(
    problem: Problem,
    aim: FloatArray,
    place: FloatArray,
    random: IntArray,
    n_body: int,
    n_drive: int,
) -> None:
    """Draw v*; with probability 1/2, all bodies share one rigid motion of the plane."""
    together = _uniform(random) < 0.5
    spin = _between(random, -1.0, 1.0)
    vx = _between(random, -1.0, 1.0)
    vy = _between(random, -1.0, 1.0)
    for b in range(n_body):
        place[b, 0] = 2.2 * (b % 3) + _between(random, -0.1, 0.1)
        place[b, 1] = 2.2 * (b // 3) + _between(random, -0.1, 0.1)
        if together:
            aim[3 * b] = vx - spin * place[b, 1]
            aim[3 * b + 1] = vy + spin * place[b, 0]
            aim[3 * b + 2] = spin
        else:
            for k in range(3):
                aim[3 * b + k] = _between(random, -1.0, 1.0)
    for d in range(n_drive):
        aim[3 * n_body + d] = _between(random, 0.0, 1.0)


@kernel
def _draw_bodies(
    problem: Problem, random: IntArray, motion: int, strength: float, n_body: int, heavy: bool
) -> None:
    """Draw inertia and momentum of the bodies."""
    for b in range(n_body):
        o = 3 * b
        for i in range(3):
            problem.momentum[o + i] = 0.0
            for j in range(3):
                problem.inertia[o + i, j] = 0.0
        mass = _spread(random, 0.2, 5.0)
        if heavy:
            # A ratio of 1e6 around the unit of mass: the tolerance of residuals is absolute, and a
            # momentum beyond 1e6 could not be balanced with 16 digits.
            mass *= 1e3 if b % 2 == 1 else 1e-3
        gyration = _between(random, 0.1, 0.6)
        if motion == DYNAMIC:
            problem.inertia[o, 0] = mass
            problem.inertia[o + 1, 1] = mass
            problem.inertia[o + 2, 2] = mass * gyration
            for k in range(3):
                problem.momentum[o + k] = problem.inertia[o + k, k] * _between(random, -1.0, 1.0)
        elif motion == FIRST_ORDER:
            # Drag of two points: positive definite, with coupling.
            x = _between(random, -0.2, 0.2)
            y = _between(random, -0.2, 0.2)
            drag = strength * mass
            problem.inertia[o, 0] = drag
            problem.inertia[o + 1, 1] = drag
            problem.inertia[o, 2] = -drag * y
            problem.inertia[o + 2, 0] = -drag * y
            problem.inertia[o + 1, 2] = drag * x
            problem.inertia[o + 2, 1] = drag * x
            problem.inertia[o + 2, 2] = drag * (gyration + x * x + y * y)
            if _uniform(random) < 0.3:
                for k in range(3):
                    problem.momentum[o + k] = drag * _between(random, -1.0, 1.0)


@kernel
def _draw_supports(
    problem: Problem, random: IntArray, strength: float, n_body: int, collinear: bool, motion: int
) -> int:
    """Draw supports: mostly tripods, else one point or one ellipsoid. A quasi-static body may be
    pulled by less than its friction holds."""
    sides = 0 if _uniform(random) < 0.5 else 4 * _whole(random, 1, 4)
    e = 0
    for b in range(n_body):
        limit = strength * _spread(random, 0.2, 5.0)
        angle = _between(random, 0.0, 2.0 * math.pi)
        pick = _uniform(random)
        n_point = 3
        if pick < 0.1 or pick > 0.95:
            n_point = 1
        reach = 0.0 if n_point == 1 else _between(random, 0.2, 0.8)
        for k in range(n_point):
            turn = angle + k * 2.0 * math.pi / 3.0
            rx = reach * math.cos(turn)
            ry = reach * math.sin(turn)
            if collinear:
                rx = (k - 1) * reach * math.cos(angle)
                ry = (k - 1) * reach * math.sin(angle)
            problem.element_dof[e] = 3 * b
            problem.element_sides[e] = sides
            problem.element_limit[e] = limit / n_point
            for i in range(3):
                problem.element_bias[e, i] = 0.0
                for j in range(3):
                    problem.element_row[e, i, j] = 0.0
            problem.element_row[e, 0, 0] = 1.0
            problem.element_row[e, 1, 1] = 1.0
            problem.element_row[e, 0, 2] = -ry
            problem.element_row[e, 1, 2] = rx
            if pick < 0.1:
                problem.element_sides[e] = 0
                problem.element_row[e, 2, 2] = _between(random, 0.1, 0.8)
            e += 1
        if motion == QUASI_STATIC and _uniform(random) < 0.15:
            # Half of the force that a square friction limit of the same radius holds along an axis.
            pull = 0.5 * limit * _between(random, 0.0, 1.0)
            problem.momentum[3 * b] = pull * math.cos(angle)
            problem.momentum[3 * b + 1] = pull * math.sin(angle)
    return e


@kernel
def _draw_drives(
    problem: Problem, aim: FloatArray, random: IntArray, strength: float, first: int, n_drive: int
) -> None:
    for d in range(n_drive):
        o = problem.size[N_FREE_DOF] + d
        e = first + d
        for k in range(3):
            problem.inertia[o, k] = 0.0
            problem.element_bias[e, k] = 0.0
            for j in range(3):
                problem.element_row[e, k, j] = 0.0
        problem.momentum[o] = 0.0
        problem.element_dof[e] = o
        problem.element_sides[e] = 0
        problem.element_row[e, 0, 0] = 1.0
        problem.element_bias[e, 0] = -_between(random, 0.1, 1.0)
        problem.element_limit[e] = strength * _spread(random, 1.0, 100.0)


@kernel
def _draw_contact(
    problem: Problem, place: FloatArray, random: IntArray, i: int, n_body: int, n_drive: int
) -> None:
    """Draw the rows of a contact of two neighbours, or of a body with an obstacle or a drive."""
    a = _whole(random, 0, n_body - 1)
    b = _whole(random, 0, n_body - 1)
    direction = _between(random, 0.0, 2.0 * math.pi)
    px = place[a, 0] + math.cos(direction) * _between(random, 0.6, 1.1)
    py = place[a, 1] + math.sin(direction) * _between(random, 0.6, 1.1)
    second = -1
    if n_body > 1 and b != a and _uniform(random) < 0.7:
        second = 3 * b
        px = 0.5 * (place[a, 0] + place[b, 0])
        py = 0.5 * (place[a, 1] + place[b, 1])
    elif n_drive > 0 and _uniform(random) < 0.6:
        second = 3 * n_body + _whole(random, 0, n_drive - 1)
    turn = math.atan2(place[a, 1] - py, place[a, 0] - px) + _between(random, -0.6, 0.6)
    nx = math.cos(turn)
    ny = math.sin(turn)
    problem.contact_dof[i, 0] = 3 * a
    problem.contact_dof[i, 1] = second
    rx = px - place[a, 0]
    ry = py - place[a, 1]
    for k in range(6):
        problem.normal[i, k] = 0.0
        problem.tangent[i, k] = 0.0
    problem.normal[i, 0] = nx
    problem.normal[i, 1] = ny
    problem.normal[i, 2] = rx * ny - ry * nx
    problem.tangent[i, 0] = -ny
    problem.tangent[i, 1] = nx
    problem.tangent[i, 2] = rx * nx + ry * ny
    if 0 <= second < problem.size[N_FREE_DOF]:
        rx = px - place[b, 0]
        ry = py - place[b, 1]
        problem.normal[i, 3] = -nx
        problem.normal[i, 4] = -ny
        problem.normal[i, 5] = -(rx * ny - ry * nx)
        problem.tangent[i, 3] = ny
        problem.tangent[i, 4] = -nx
        problem.tangent[i, 5] = -(rx * nx + ry * ny)
    elif second >= 0:
        heading = _between(random, 0.0, 2.0 * math.pi)
        problem.normal[i, 3] = -math.cos(heading)
        problem.tangent[i, 3] = -math.sin(heading)


@kernel
def _copy_contact(problem: Problem, source: int, target: int) -> None:
    for k in range(6):
        problem.normal[target, k] = problem.normal[source, k]
        problem.tangent[target, k] = problem.tangent[source, k]
    for k in range(2):
        problem.contact_dof[target, k] = problem.contact_dof[source, k]
        problem.bias[target, k] = problem.bias[source, k]
    problem.friction[target] = problem.friction[source]


@kernel
def _draw_room(problem: Problem, aim: FloatArray, random: IntArray, i: int, snug: bool) -> None:
    """Draw a bias of contact i such that v* has room there: ``u_n = mu |u_t| + room``."""
    un = 0.0
    ut = 0.0
    for side in range(2):
        o = problem.contact_dof[i, side]
        if o >= 0:
            for k in range(3):
                un += problem.normal[i, 3 * side + k] * aim[o + k]
                ut += problem.tangent[i, 3 * side + k] * aim[o + k]
    bias_t = 0.0
    o = problem.contact_dof[i, 1]
    if o < 0 or snug:
        # An obstacle that moves too, sometimes exactly along with the body.
        bias_t = -ut if snug or _uniform(random) < 0.3 else _between(random, -0.5, 0.5)
    room = 0.0 if snug else _spread(random, 1e-3, 1.0)
    problem.bias[i, 1] = bias_t
    problem.bias[i, 0] = room + problem.friction[i] * abs(ut + bias_t) - un


@kernel
def shift(problem: Problem, aim: FloatArray, random: IntArray, motion: int) -> None:
    """Change a solved problem to one that could be its next step; the impulses are unchanged."""
    for o in range(0, problem.size[N_FREE_DOF], 3):
        if motion == DYNAMIC:
            for k in range(3):
                problem.momentum[o + k] = problem.inertia[o + k, k] * problem.velocity[o + k]
    for i in range(problem.size[N_CONTACT]):
        if _uniform(random) < 0.2:
            problem.bias[i, 0] += _spread(random, 1e-4, 0.3)
    for e in range(problem.size[N_ELEMENT]):
        problem.element_limit[e] *= _between(random, 0.9, 1.1) if motion == DYNAMIC else 1.0


@allocating_kernel
def _room() -> tuple[Problem, Workspace]:
    problem = empty_problem(MAX_DOF, MAX_CONTACTS, MAX_ELEMENTS)
    work = empty_workspace(MAX_DOF, MAX_CONTACTS, MAX_ELEMENTS, 0, 0, 0, 0)
    return problem, work


@entry
def draw(seed: int) -> tuple[Problem, Workspace, FloatArray, int]:
    """Draw the problem of a seed; return it, its workspace, the velocity v*, and its motion."""
    problem, work = _room()
    aim = np.zeros(MAX_DOF + 2)
    motion, _ = fill(problem, aim, np.zeros((MAX_BODIES, 2)), np.zeros(1, np.int64), seed)
    return problem, work, aim, motion


@entry
def _begin(
    problem: Problem,
    aim: FloatArray,
    guess: FloatArray,
    place: FloatArray,
    random: IntArray,
    seed: int,
) -> int:
    """Draw the problem of a seed and a cold start; return its motion."""
    motion, _ = fill(problem, aim, place, random, seed)
    share = _uniform(random)
    for i in range(problem.size[N_DOF]):
        # Cold start: from rest, from v*, or from a share of v*.
        guess[i] = aim[i] * (0.0 if share < 0.3 else (1.0 if share < 0.6 else share))
        problem.velocity[i] = guess[i]
    return motion


@entry
def _go_on(
    problem: Problem, aim: FloatArray, guess: FloatArray, random: IntArray, motion: int
) -> None:
    """Change a solved problem to one that could be its next step, which starts warm."""
    shift(problem, aim, random, motion)
    for i in range(problem.size[N_DOF]):
        guess[i] = problem.velocity[i]


def solve_many(
    first: int, count: int, solver: int, effort: int, failed: IntArray, tally: FloatArray
) -> int:
    """Draw and solve the problems `first` to ``first + count - 1``, each cold and then warm.

    `failed` (n,) receives ``2 seed + (1 if warm)`` of the first n failures. In `tally` (4,), the
    numbers of solver calls and of fallbacks are added to [0] and [1], and [2] becomes the largest
    residual of a success. Returns the number of failures.
    """
    problem, work = entries.empty(MAX_DOF, MAX_CONTACTS, MAX_ELEMENTS, 0, 0, 0, 0)
    aim = np.zeros(MAX_DOF + 2)
    guess = np.zeros(MAX_DOF + 2)
    place = np.zeros((MAX_BODIES, 2))
    random = np.zeros(1, np.int64)
    n_failed = 0
    for seed in range(first, first + count):
        motion = _begin(problem, aim, guess, place, random, seed)
        for warm in range(2):
            if warm == 1:
                _go_on(problem, aim, guess, random, motion)
            off, fell_back = entries.solve_problem(
                problem, work, guess, solver, effort, MAX_ATTEMPTS
            )
            tally[:2] += 1.0, fell_back
            if off <= TOLERANCE:
                tally[2] = max(tally[2], off)
            else:
                if n_failed < failed.size:
                    failed[n_failed] = 2 * seed + warm
                n_failed += 1
                break
    return n_failed
