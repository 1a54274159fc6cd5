"""Solution of large problems island by island.

Bodies that press on each other form an island. Islands are independent and are solved one at a
time, as separate problems. Contacts that carried no impulse and open at the guessed velocity are
left out at first; those that the solution violates are then added, and the islands that they join
are solved again. Within an island the bodies are numbered by reverse Cuthill-McKee, so that the
linear systems have a narrow band.

Source: George & Liu (1981), section 4.3, for the numbering.
"""

from typing import NamedTuple

from fixel.kernels.arrays import N_CONTACT, N_DOF, N_ELEMENT, N_FREE_DOF, N_SIZE, Problem, Workspace
from fixel.kernels.jit import kernel, view
from fixel.typing import FloatArray, IntArray

NEARLY = 0.1  # of the fastest motion: contacts that open more slowly are not left out
ROUNDS = 12  # of adding contacts, before all are added


class Islands(NamedTuple):
    """Views of `work.island_floats` and `work.island_indices`. Blocks are bodies, then
    drives."""

    part: Problem  # one island
    guess: FloatArray  # (n_dof + 2,)
    contact_in: IntArray  # (n_contact,) 0 where left out
    island: IntArray  # (n_dof + 2,) smallest block of each block's island
    place: IntArray  # (n_dof + 2,) each block's first degree of freedom within its island
    degree: IntArray  # (n_dof + 2,) contacts of each body with other bodies
    first: IntArray  # (n_dof + 2,) first neighbour of each body; later, 1 for islands to solve
    neighbour: IntArray  # (2 n_contact,)
    sequence: IntArray  # (n_dof + 2,) bodies in the order in which islands number them
    head: IntArray  # (n_dof + 2, 3) first body, contact and element of each island; -1 for none
    next_body: IntArray  # (n_dof + 2,) that of the same island after each; -1 for none
    next_contact: IntArray  # (n_contact,)
    next_element: IntArray  # (n_element,)


@kernel
def island_room(wide: int, n_contact: int, n_element: int) -> tuple[int, int]:
    """Sizes of the two buffers that `islands_of` needs, for ``wide = n_dof + 2``."""
    return (
        7 * wide + 17 * n_contact + 16 * n_element,
        N_SIZE + 9 * wide + 6 * n_contact + 3 * n_element,
    )


@kernel
def islands_of(problem: Problem, work: Workspace) -> Islands:
    """Return the arrays of `Islands`, as consecutive views of the buffers."""
    x = work.island_floats
    i = work.island_indices
    wide = problem.momentum.size
    c = problem.friction.size
    e = problem.element_limit.size
    y = 7 * wide
    z = y + 17 * c
    j = N_SIZE + 9 * wide
    k = j + 6 * c
    part = Problem(
        size=view(i, 0, (N_SIZE,)),
        inertia=view(x, 0, (wide, 3)),
        momentum=view(x, 3 * wide, (wide,)),
        velocity=view(x, 4 * wide, (wide,)),
        stiffness=view(x, 5 * wide, (wide,)),
        contact_dof=view(i, j, (c, 2)),
        contact_key=view(i, j, (0,)),
        contact_body=view(i, j, (0, 2)),
        contact_place=view(x, y, (0, 5)),
        normal=view(x, y, (c, 6)),
        tangent=view(x, y + 6 * c, (c, 6)),
        bias=view(x, y + 12 * c, (c, 2)),
        friction=view(x, y + 14 * c, (c,)),
        impulse=view(x, y + 15 * c, (c, 2)),
        element_dof=view(i, k, (e,)),
        element_sides=view(i, k + e, (e,)),
        element_row=view(x, z, (e, 3, 3)),
        element_bias=view(x, z + 9 * e, (e, 3)),
        element_limit=view(x, z + 12 * e, (e,)),
        element_impulse=view(x, z + 13 * e, (e, 3)),
    )
    return Islands(
        part=part,
        guess=view(x, 6 * wide, (wide,)),
        contact_in=view(i, j + 2 * c, (c,)),
        island=view(i, N_SIZE, (wide,)),
        place=view(i, N_SIZE + wide, (wide,)),
        degree=view(i, N_SIZE + 2 * wide, (wide,)),
        first=view(i, N_SIZE + 3 * wide, (wide,)),
        neighbour=view(i, j + 3 * c, (2 * c,)),
        sequence=view(i, N_SIZE + 4 * wide, (wide,)),
        head=view(i, N_SIZE + 5 * wide, (wide, 3)),
        next_body=view(i, N_SIZE + 8 * wide, (wide,)),
        next_contact=view(i, j + 5 * c, (c,)),
        next_element=view(i, k + 2 * e, (e,)),
    )


@kernel
def choose_contacts(problem: Problem, islands: Islands, everything: bool) -> int:
    """Add the contacts that press or close; returns the number of contacts added.

    `islands.contact_in` is 1 for contacts that take part, and 2 for those added by this call.
    """
    added = 0
    v = problem.velocity
    fastest = 0.0
    for o in range(problem.size[N_DOF]):
        fastest = max(fastest, abs(v[o]))
    for i in range(problem.size[N_CONTACT]):
        if islands.contact_in[i] > 0:
            islands.contact_in[i] = 1
            continue
        opening = problem.bias[i, 0]
        for side in range(2):
            o = problem.contact_dof[i, side]
            if o >= 0:
                for k in range(3):
                    opening += problem.normal[i, 3 * side + k] * v[o + k]
        if everything or opening < NEARLY * fastest or problem.impulse[i, 0] > 0.0:
            islands.contact_in[i] = 2
            added += 1
        else:
            problem.impulse[i, 1] = 0.0
    return added


@kernel
def block_of(n_free: int, dof: int) -> int:
    """Index of the block of a degree of freedom: bodies first, then drives."""
    return dof // 3 if dof < n_free else n_free // 3 + dof - n_free


@kernel
def _root(island: IntArray, block: int) -> int:
    while island[block] != block:
        island[block] = island[island[block]]
        block = island[block]
    return block


@kernel
def find_islands(problem: Problem, islands: Islands) -> int:
    """Number the blocks island by island; returns the number of blocks.

    On return `islands.island[block]` is the smallest block of its island, and `islands.sequence`
    lists the bodies in reverse Cuthill-McKee order.
    """
    n_body = problem.size[N_FREE_DOF] // 3
    n_block = n_body + problem.size[N_DOF] - problem.size[N_FREE_DOF]
    island = islands.island
    degree = islands.degree
    for b in range(n_block + 1):
        island[b] = b
        degree[b] = 0
    for i in range(problem.size[N_CONTACT]):
        second = problem.contact_dof[i, 1]
        if islands.contact_in[i] == 0 or second < 0:
            continue
        a = _root(island, block_of(problem.size[N_FREE_DOF], problem.contact_dof[i, 0]))
        b = _root(island, block_of(problem.size[N_FREE_DOF], second))
        # The smaller number stays the root.
        island[max(a, b)] = min(a, b)
        if second < problem.size[N_FREE_DOF]:
            degree[problem.contact_dof[i, 0] // 3] += 1
            degree[second // 3] += 1
    for b in range(n_block):
        island[b] = _root(island, b)
    _list_neighbours(problem, islands, n_body)
    _number(islands, n_body)
    _list_members(problem, islands, n_block)
    return n_block


@kernel
def _list_members(problem: Problem, islands: Islands, n_block: int) -> None:
    """Chain the bodies, contacts and elements of each island, so that it is gathered in a time that
    does not depend on the others."""
    head = islands.head
    n_free = problem.size[N_FREE_DOF]
    for b in range(n_block):
        for k in range(3):
            head[b, k] = -1
    for k in range(n_free // 3 - 1, -1, -1):
        b = islands.sequence[k]
        root = islands.island[b]
        islands.next_body[b] = head[root, 0]
        head[root, 0] = b
    for i in range(problem.size[N_CONTACT] - 1, -1, -1):
        if islands.contact_in[i] > 0:
            root = islands.island[block_of(n_free, problem.contact_dof[i, 0])]
            islands.next_contact[i] = head[root, 1]
            head[root, 1] = i
    for e in range(problem.size[N_ELEMENT] - 1, -1, -1):
        root = islands.island[block_of(n_free, problem.element_dof[e])]
        islands.next_element[e] = head[root, 2]
        head[root, 2] = e


@kernel
def _list_neighbours(problem: Problem, islands: Islands, n_body: int) -> None:
    """Write ``islands.neighbour[first[b]:first[b + 1]]``: the bodies that body b touches, some of
    them twice."""
    first = islands.first
    first[0] = 0
    for b in range(n_body):
        first[b + 1] = first[b] + islands.degree[b]
        islands.sequence[b] = first[b]
    for i in range(problem.size[N_CONTACT]):
        second = problem.contact_dof[i, 1]
        if islands.contact_in[i] == 0 or second < 0 or second >= problem.size[N_FREE_DOF]:
            continue
        a = problem.contact_dof[i, 0] // 3
        b = second // 3
        islands.neighbour[islands.sequence[a]] = b
        islands.neighbour[islands.sequence[b]] = a
        islands.sequence[a] += 1
        islands.sequence[b] += 1


@kernel
def _number(islands: Islands, n_body: int) -> None:
    """Number the bodies breadth first from one of least degree, neighbours of least degree first;
    then reverse the order."""
    seen = islands.place
    sequence = islands.sequence
    degree = islands.degree
    for b in range(n_body):
        seen[b] = 0
    count = 0
    while count < n_body:
        start = -1
        for b in range(n_body):
            if seen[b] == 0 and (start < 0 or degree[b] < degree[start]):
                start = b
        seen[start] = 1
        sequence[count] = start
        head = count
        count += 1
        while head < count:
            b = sequence[head]
            head += 1
            begin = count
            for k in range(islands.first[b], islands.first[b + 1]):
                other = islands.neighbour[k]
                if seen[other] == 0:
                    seen[other] = 1
                    j = count
                    while j > begin and degree[sequence[j - 1]] > degree[other]:
                        sequence[j] = sequence[j - 1]
                        j -= 1
                    sequence[j] = other
                    count += 1
    for k in range(n_body // 2):
        swap = sequence[k]
        sequence[k] = sequence[n_body - 1 - k]
        sequence[n_body - 1 - k] = swap


@kernel
def mark_changed(problem: Problem, islands: Islands, n_block: int, everything: bool) -> None:
    """Set ``islands.first`` to 1 for the islands to solve: those with newly added contacts, or
    all."""
    for b in range(n_block):
        islands.first[b] = 1 if everything else 0
    for i in range(problem.size[N_CONTACT]):
        if islands.contact_in[i] == 2:
            block = block_of(problem.size[N_FREE_DOF], problem.contact_dof[i, 0])
            islands.first[islands.island[block]] = 1


@kernel
def gather(
    problem: Problem, work: Workspace, islands: Islands, guess: FloatArray, island: int
) -> None:
    """Copy one island into `islands.part`, numbered by `islands.sequence`, and its guess into
    `islands.guess`."""
    part = islands.part
    n_body = problem.size[N_FREE_DOF] // 3
    n_dof = 0
    b = islands.head[island, 0]
    while b >= 0:
        islands.place[b] = n_dof
        for j in range(3):
            _copy_dof(problem, islands, guess, 3 * b + j, n_dof + j)
        n_dof += 3
        b = islands.next_body[b]
    part.size[N_FREE_DOF] = n_dof
    for d in range(problem.size[N_DOF] - problem.size[N_FREE_DOF]):
        if islands.island[n_body + d] == island:
            islands.place[n_body + d] = n_dof
            _copy_dof(problem, islands, guess, problem.size[N_FREE_DOF] + d, n_dof)
            n_dof += 1
    part.size[N_DOF] = n_dof
    _gather_contacts(problem, work.profile, islands, island)
    _gather_elements(problem, islands, island)


@kernel
def _copy_dof(
    problem: Problem, islands: Islands, guess: FloatArray, source: int, target: int
) -> None:
    part = islands.part
    for m in range(3):
        part.inertia[target, m] = problem.inertia[source, m]
    part.momentum[target] = problem.momentum[source]
    part.velocity[target] = problem.velocity[source]
    part.stiffness[target] = problem.stiffness[source]
    islands.guess[target] = guess[source]


@kernel
def _gather_contacts(problem: Problem, profile: IntArray, islands: Islands, island: int) -> None:
    part = islands.part
    for k in range(part.size[N_DOF]):
        profile[k] = k - k % 3 + 3
    n = 0
    i = islands.head[island, 1]
    while i >= 0:
        a = problem.contact_dof[i, 0]
        part.contact_dof[n, 0] = islands.place[block_of(problem.size[N_FREE_DOF], a)]
        b = problem.contact_dof[i, 1]
        part.contact_dof[n, 1] = -1
        if b >= 0:
            part.contact_dof[n, 1] = islands.place[block_of(problem.size[N_FREE_DOF], b)]
        for k in range(6):
            part.normal[n, k] = problem.normal[i, k]
            part.tangent[n, k] = problem.tangent[i, k]
        for k in range(2):
            part.bias[n, k] = problem.bias[i, k]
            part.impulse[n, k] = problem.impulse[i, k]
        part.friction[n] = problem.friction[i]
        if 0 <= b < problem.size[N_FREE_DOF]:
            low = min(part.contact_dof[n, 0], part.contact_dof[n, 1])
            high = max(part.contact_dof[n, 0], part.contact_dof[n, 1])
            profile[low] = max(profile[low], high + 3)
        n += 1
        i = islands.next_contact[i]
    part.size[N_CONTACT] = n
    reach = 0
    for k in range(part.size[N_FREE_DOF]):
        reach = max(reach, profile[k])
        profile[k] = reach


@kernel
def _gather_elements(problem: Problem, islands: Islands, island: int) -> None:
    part = islands.part
    n = 0
    e = islands.head[island, 2]
    while e >= 0:
        block = block_of(problem.size[N_FREE_DOF], problem.element_dof[e])
        part.element_dof[n] = islands.place[block]
        part.element_sides[n] = problem.element_sides[e]
        part.element_limit[n] = problem.element_limit[e]
        for j in range(3):
            part.element_bias[n, j] = problem.element_bias[e, j]
            part.element_impulse[n, j] = problem.element_impulse[e, j]
            for k in range(3):
                part.element_row[n, j, k] = problem.element_row[e, j, k]
        n += 1
        e = islands.next_element[e]
    part.size[N_ELEMENT] = n


@kernel
def scatter(problem: Problem, islands: Islands, island: int) -> None:
    """Copy the solution of one island back into the problem."""
    part = islands.part
    n_body = problem.size[N_FREE_DOF] // 3
    b = islands.head[island, 0]
    while b >= 0:
        for k in range(3):
            problem.velocity[3 * b + k] = part.velocity[islands.place[b] + k]
        b = islands.next_body[b]
    for d in range(problem.size[N_DOF] - problem.size[N_FREE_DOF]):
        if islands.island[n_body + d] == island:
            problem.velocity[problem.size[N_FREE_DOF] + d] = part.velocity[
                islands.place[n_body + d]
            ]
    n = 0
    i = islands.head[island, 1]
    while i >= 0:
        for k in range(2):
            problem.impulse[i, k] = part.impulse[n, k]
        n += 1
        i = islands.next_contact[i]
    n = 0
    e = islands.head[island, 2]
    while e >= 0:
        for k in range(3):
            problem.element_impulse[e, k] = part.element_impulse[n, k]
        n += 1
        e = islands.next_element[e]
