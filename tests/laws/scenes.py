"""Random scenes for the laws: small, but of every kind of shape, support, drive and obstacle."""

from dataclasses import replace
from math import pi

import numpy as np
from hypothesis import strategies as st

from fixel.model import (
    Body,
    Disk,
    Ellipsoid,
    Fixel,
    FrictionMap,
    LineDrive,
    LoadMap,
    NoSupport,
    PairFriction,
    PathDrive,
    Plane,
    Polygon,
    Pusher,
    Scene,
    Spring,
    SupportPoints,
    Tripod,
    UniformPressure,
)
from fixel.testing.scenes import box

SIZE = 0.03  # [m] largest radius of a body
PITCH = 0.075  # [m] of the grid on which bodies stand clear of one another

_L_SHAPE = [[0, 0], [0.03, 0], [0.03, 0.012], [0.012, 0.012], [0.012, 0.03], [0, 0.03]]


def kinetic_energy(scene, run) -> np.ndarray:
    """Kinetic energy (n,) of all bodies of a simulation [J]."""
    energy = np.zeros(len(run.time))
    for body in scene.bodies:
        v = run.twist[body.name]
        energy += 0.5 * body.mass * (v[:, 0] ** 2 + v[:, 1] ** 2)
        energy += 0.5 * body.moment_of_inertia * v[:, 2] ** 2
    return energy


def _number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.integers(0, 10_000).map(lambda k: low + (high - low) * k / 10_000)


@st.composite
def shapes(draw):
    kind = draw(st.sampled_from(["box", "disk", "polygon", "L"]))
    if kind == "disk":
        return Disk(draw(_number(0.01, SIZE)))
    if kind == "box":
        return box(draw(_number(0.01, 0.04)), draw(_number(0.01, 0.04)))
    if kind == "L":
        return Polygon(_L_SHAPE)
    n = draw(st.integers(3, 7))
    r = draw(_number(0.015, SIZE))
    return Polygon([[r * np.cos(a), r * np.sin(a)] for a in 2 * pi * np.arange(n) / n])


@st.composite
def supports(draw, none: bool = False):
    kinds = ["tripod", "points", "uniform", "ellipsoid"] + (["none"] if none else [])
    kind = draw(st.sampled_from(kinds))
    mu = draw(_number(0.05, 0.8))
    if kind == "tripod":
        return Tripod(radius=draw(_number(0.004, 0.02)), friction=mu, angle=draw(_number(0.0, 2.0)))
    if kind == "points":
        points = [(0.01, 0.0), (0.0, 0.012), (-0.008, -0.01), (0.004, -0.002)]
        return SupportPoints(points=points, friction=mu)
    if kind == "uniform":
        return UniformPressure(friction=mu, n_points=12)
    if kind == "ellipsoid":
        force = mu * 0.1 * 9.81
        return Ellipsoid(force=force, torque=0.012 * force)
    return NoSupport()


@st.composite
def scenes(draw, none: bool = False, drive: bool = True, thrown: bool = False, e: bool = False):
    """Up to three bodies in a column, pushed along +x into up to three pegs, or thrown about.

    `none` allows bodies without support, `drive` adds the pusher, `thrown` gives velocities, `e`
    allows restitution, and takes friction between bodies away.
    """
    mu = 0.0 if e else draw(_number(0.0, 0.9))
    restitution = draw(_number(0.0, 1.0)) if e else 0.0
    bodies = []
    for k in range(draw(st.integers(1, 3))):
        velocity = (0.0, 0.0, 0.0)
        if thrown:
            velocity = tuple(draw(_number(-w, w)) for w in (0.5, 0.5, 8.0))
        bodies.append(
            Body(
                name=f"body-{k}",
                shape=draw(shapes()),
                mass=draw(_number(0.05, 0.3)),
                pose=(
                    PITCH * (k % 2) + draw(_number(-0.005, 0.005)),
                    PITCH * (k - 1) + draw(_number(-0.005, 0.005)),
                    draw(_number(-3.0, 3.0)),
                ),
                velocity=velocity,
                support=draw(supports(none=none)),
            )
        )
    pegs = [
        Fixel(
            name=f"fixel-{k}",
            shape=Disk(0.005),
            pose=(0.18, 0.05 * (k - 1) + draw(_number(-0.01, 0.01)), 0.0),
            friction=mu,
            restitution=restitution,
        )
        for k in range(draw(st.integers(0, 3)))
    ]
    pushers = []
    if drive:
        speed = draw(_number(0.02, 0.2))
        limit = draw(st.one_of(st.none(), _number(0.5, 5.0)))
        # A rigid drive stops short of the pegs, so that nothing can jam.
        line = LineDrive(direction=(1, 0), speed=speed, travel=0.06, force_limit=limit)
        pushers.append(
            Pusher(name="plate", shape=box(0.01, 0.3), pose=(-0.06, 0, 0), drive=line, friction=mu)
        )
    entry = PairFriction(pair=("body-*", "body-*"), friction=mu, restitution=restitution)
    return Scene(
        bodies=bodies, pushers=pushers, fixels=pegs, contact_friction=(entry,), duration=0.5
    )


def table_push(seed: int) -> Scene:
    """Turning tool on a path with corners and reversals, on an uneven table with a grain."""
    rng = np.random.default_rng([32, seed])
    steps = rng.uniform([0.1, -0.01, -0.008, -0.3], [0.2, 0.02, 0.008, 0.3], (8, 4))
    path = np.vstack(((0.0, -0.045, 0.003, 0.0), steps)).cumsum(axis=0)
    grid = {"origin": (-0.12, -0.1), "cell": (0.05, 0.06)}
    spots = rng.normal(size=(2, 4, 5))
    feet = rng.dirichlet(np.ones(5)) * 0.1 * 9.81
    points = rng.uniform(-0.012, 0.012, (5, 2))
    shape = Polygon(_L_SHAPE)
    points += shape.centroid - feet @ points / feet.sum()
    return Scene(
        Body(
            "part", shape, mass=0.1, pose=(0.0, 0.0, rng.uniform(-3.0, 3.0)),
            support=SupportPoints(points=points, friction=0.3, loads=feet),
            spring=Spring(stiffness=0.5, anchor=(0.02, 0.05)),
        ),
        Pusher(
            "tool", box(0.02, 0.03), friction=rng.uniform(0.0, 0.6),
            drive=PathDrive(path, force_limit=(None, 1.0, 0.3)[seed % 3]),
        ),
        Fixel("peg", Disk(0.005), pose=(0.06, 0.01, 0.0), friction=0.3),
        plane=Plane(
            anisotropy=(1.2, 0.8), axis=0.4,
            friction_map=FrictionMap(**grid, factor=np.exp(0.3 * spots[0])),
            load_map=LoadMap(**grid, log_load=0.3 * spots[1]),
        ),
        duration=1.2,
    )  # fmt: skip


def quarter_turned(plane: Plane) -> Plane:
    """The table turned by 90 degrees about the origin."""

    def turned(old, name):
        values = getattr(old, name)
        origin = (-old.origin[1] - old.cell[1] * (len(values) - 1), old.origin[0])
        return replace(old, origin=origin, cell=old.cell[::-1], **{name: values[::-1].T})

    return replace(
        plane,
        axis=plane.axis + pi / 2,
        friction_map=turned(plane.friction_map, "factor"),
        load_map=turned(plane.load_map, "log_load"),
    )


def mirrored(scene: Scene) -> Scene:
    """The scene reflected in the x axis."""
    flip = np.array([1.0, -1.0])
    turn = np.array([1.0, -1.0, -1.0])

    def shape(old):
        return old if isinstance(old, Disk) else Polygon(old.vertices * flip)

    def support(old):
        if isinstance(old, Tripod):
            return replace(old, angle=-old.angle)
        if isinstance(old, SupportPoints):
            return replace(old, points=old.points * flip)
        return replace(old, centre=old.centre * flip) if isinstance(old, Ellipsoid) else old

    def drive(old):
        if isinstance(old, PathDrive):
            return replace(old, waypoints=old.waypoints * [1.0, 1.0, -1.0, -1.0])
        return replace(old, direction=old.direction * flip)

    def spots(old, name):
        if old is None:
            return None
        values = getattr(old, name)
        origin = (old.origin[0], -old.origin[1] - old.cell[1] * (len(values) - 1))
        return replace(old, origin=origin, **{name: values[::-1]})

    plane = scene.plane
    return replace(
        scene,
        bodies=tuple(
            replace(
                b,
                shape=shape(b.shape),
                pose=b.pose * turn,
                velocity=b.velocity * turn,
                support=support(b.support),
                spring=b.spring and replace(b.spring, anchor=b.spring.anchor * flip),
            )
            for b in scene.bodies
        ),
        pushers=tuple(
            replace(p, shape=shape(p.shape), pose=p.pose * turn, drive=drive(p.drive))
            for p in scene.pushers
        ),
        fixels=tuple(replace(f, shape=shape(f.shape), pose=f.pose * turn) for f in scene.fixels),
        plane=replace(
            plane,
            axis=-plane.axis,
            friction_map=spots(plane.friction_map, "factor"),
            load_map=spots(plane.load_map, "log_load"),
        ),
    )


def rescaled(scene: Scene, length: float, mass: float, time: float) -> Scene:
    """The same scene with lengths, masses and times multiplied."""
    speed, force = length / time, mass * length / time**2
    stretch, rate = np.array([length, length, 1.0]), np.array([speed, speed, 1.0 / time])

    def shape(old):
        if isinstance(old, Disk):
            return Disk(length * old.radius)
        return Polygon(length * old.vertices)

    def support(old):
        if isinstance(old, Tripod):
            return replace(old, radius=length * old.radius)
        if isinstance(old, SupportPoints):
            loads = None if old.loads is None else force * old.loads
            return replace(old, points=length * old.points, loads=loads)
        if isinstance(old, Ellipsoid):
            return Ellipsoid(
                force=force * old.force,
                torque=force * length * old.torque,
                centre=length * old.centre,
            )
        return old

    def drive(old):
        limit = None if old.force_limit is None else force * old.force_limit
        if isinstance(old, PathDrive):
            return PathDrive(old.waypoints * [time, length, length, 1.0], force_limit=limit)
        return replace(old, speed=speed * old.speed, travel=length * old.travel, force_limit=limit)

    def spring(old):
        return old and Spring(stiffness=force / length * old.stiffness, anchor=length * old.anchor)

    def spots(old):
        return old and replace(old, origin=length * old.origin, cell=length * old.cell)

    plane = scene.plane
    return replace(
        scene,
        bodies=tuple(
            replace(
                b,
                shape=shape(b.shape),
                mass=mass * b.mass,
                pose=b.pose * stretch,
                velocity=b.velocity * rate,
                force=b.force * [force, force, force * length],
                support=support(b.support),
                spring=spring(b.spring),
            )
            for b in scene.bodies
        ),
        pushers=tuple(
            replace(p, shape=shape(p.shape), pose=p.pose * stretch, drive=drive(p.drive))
            for p in scene.pushers
        ),
        fixels=tuple(replace(f, shape=shape(f.shape), pose=f.pose * stretch) for f in scene.fixels),
        plane=replace(
            plane, friction_map=spots(plane.friction_map), load_map=spots(plane.load_map)
        ),
        gravity=scene.gravity * length / time**2,
        duration=scene.duration * time,
    )
