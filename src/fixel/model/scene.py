"""Scenes: all input of a rollout except the method and the parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar, final

import numpy as np

from fixel.errors import InvalidInput, check_name
from fixel.model import fields
from fixel.model.bodies import Body, Fixel, Pusher
from fixel.model.overlap import boxes, overlap_depth, pairs_of_boxes
from fixel.model.support import Plane
from fixel.registry import offered
from fixel.typing import BoolArray

T = TypeVar("T")

# Overlap at the start that still counts as touching, as a share of the larger of the two shapes.
# Smaller values would reject scenes whose poses were rounded in a file.
TOUCHING = 1e-6


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PairFriction(fields.Comparable):
    """Friction of a named pair, which overrides that of its obstacle.

    Parameters
    ----------
    pair : (str, str)
        Names in either order; `*`, `?` and `[...]` match as in a shell.
    friction : float
        Coefficient of friction [-].
    restitution : float, optional
        Coefficient of restitution, from 0 to 1 [-].

    Examples
    --------
    >>> PairFriction(("part", "fixel-*"), friction=0.2).covers("fixel-3", "part")
    True
    """

    pair: tuple[str, str]
    _: KW_ONLY
    friction: Annotated[float, fields.Value(fields.non_negative)]
    restitution: Annotated[float | None, fields.Value(fields.fraction)] = None

    def __post_init__(self) -> None:
        first, second = _two_names(self.pair)
        if first == second and not _is_pattern(first):
            found, expected = f"{first!r} twice", "two different names"
            raise InvalidInput("contact_friction.pair", found=found, expected=expected)
        restitution = self.restitution
        where = f"contact_friction of {first!r} and {second!r}"
        fields.settle(
            self,
            pair=(first, second),
            friction=fields.non_negative(self.friction, where),
            restitution=None if restitution is None else fields.fraction(restitution, where),
        )

    def named(self, names: Sequence[str]) -> tuple[BoolArray, BoolArray]:
        """Return masks (n,) of the names that the first and the second of the pair match."""
        first, second = self.pair
        return (
            np.array([_matches(name, first) for name in names], bool),
            np.array([_matches(name, second) for name in names], bool),
        )

    def covers(self, a: str, b: str) -> bool:
        """Whether the entry applies to bodies `a` and `b`, in either order."""
        first, second = self.pair
        return (_matches(a, first) and _matches(b, second)) or (
            _matches(b, first) and _matches(a, second)
        )

    @property
    def is_literal(self) -> bool:
        """Whether neither name is a pattern."""
        return not any(_is_pattern(name) for name in self.pair)


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Scene(fields.Comparable):
    """Bodies, pushers and fixels on a plane, with gravity and duration.

    Parameters
    ----------
    bodies : Body or sequence of Body
        Free bodies, at least one.
    pushers : Pusher or sequence of Pusher
        Driven bodies.
    fixels : Fixel or sequence of Fixel
        Fixed bodies.
    contact_friction : sequence of PairFriction
        Overrides of the obstacle's own value. Every pair of free bodies needs one. Entries without
        patterns take precedence over those with; then the first one applies.
    plane : Plane
        Dependence of support friction on direction and place.
    gravity : float
        Acceleration of gravity [m/s^2], not negative.
    duration : float or None
        Simulated time [s]; None: to be given to `simulate`, or that of an experiment.
    support_directions : int or None
        Number of friction directions at every support point, at least 4, as in the linear form of
        the complementarity problem. None: the exact friction disc.

    Raises
    ------
    InvalidInput
        There is no free body, a name occurs twice, a friction entry names no body, a pair of free
        bodies has no entry, or bodies overlap at the start.

    Examples
    --------
    >>> from fixel.model import Disk, LineDrive, Polygon, Tripod
    >>> part = Body("part", Polygon.rectangle(0.1, 0.1), mass=0.15,
    ...             support=Tripod(radius=0.038, friction=0.25))
    >>> finger = Pusher("finger", Disk(0.005), pose=(-0.055, 0.02, 0.0), friction=0.3,
    ...                 drive=LineDrive(speed=0.02))
    >>> Scene(part, finger, duration=2.0).names
    ('part', 'finger')
    """

    bodies: tuple[Body, ...]
    pushers: tuple[Pusher, ...] = ()
    fixels: tuple[Fixel, ...] = ()
    _: KW_ONLY
    contact_friction: tuple[PairFriction, ...] = ()
    plane: Plane = field(default_factory=Plane)
    gravity: Annotated[float, fields.Value(fields.non_negative, "m/s^2")] = 9.81
    duration: Annotated[float, fields.Value(fields.positive, "s")] = None  # type: ignore[assignment]
    support_directions: int | None = None

    if TYPE_CHECKING:  # what may be given; the fields are what is kept

        def __init__(
            self,
            bodies: Body | Iterable[Body],
            pushers: Pusher | Iterable[Pusher] = (),
            fixels: Fixel | Iterable[Fixel] = (),
            *,
            contact_friction: PairFriction | Iterable[PairFriction] = (),
            plane: Plane = ...,
            gravity: float = 9.81,
            duration: float | None = None,
            support_directions: int | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        fields.settle(
            self,
            bodies=_members(self.bodies, Body, "bodies"),
            pushers=_members(self.pushers, Pusher, "pushers"),
            fixels=_members(self.fixels, Fixel, "fixels"),
            contact_friction=_members(self.contact_friction, PairFriction, "contact_friction"),
        )
        fields.check_fields(self)
        if not self.bodies:
            raise InvalidInput("bodies", found="no free body", expected="at least one")
        fields.instance(self.plane, Plane, "plane", "a Plane")
        if (n := self.support_directions) is not None:
            fields.settle(self, support_directions=fields.whole(n, "support_directions", 4))
        _check_unique_names(self.names)
        for index, entry in enumerate(self.contact_friction):
            for name in entry.pair:
                if not _is_pattern(name):
                    check_name(f"contact_friction[{index}].pair", name, self.names)
        _check_friction(self)
        _check_overlaps(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bodies, then the pushers, then the fixels."""
        things: tuple[Body | Pusher | Fixel, ...] = (*self.bodies, *self.pushers, *self.fixels)
        return tuple(thing.name for thing in things)

    def save(self, path: str | Path) -> Path:
        """Write the scene to a file, which `fixel.load_scene` reads.

        Parameters
        ----------
        path : str or path
            YAML file, or JSON if its name ends in `.json`.

        Raises
        ------
        InvalidInput
            The scene is a template, or the file cannot be written.
        """
        file = offered("methods", "scene_file")(scene=self.complete())
        offered("methods", "save_scene")(file, path)
        return Path(path)

    def complete(self, duration: float | None = None) -> Scene:
        """Return the scene itself; raise `InvalidInput` if it is a template.

        Parameters
        ----------
        duration : float, optional
            Simulated time [s], for a scene without one.
        """
        own: object = self.duration if duration is None else duration
        missing = [f"no drive of pusher {p.name!r}" for p in self.pushers if p.is_template]
        missing += ["no duration"] if own is None else []
        if missing:
            raise InvalidInput(
                "scene",
                found=f"a template: {', '.join(missing)}",
                expected="a drive for every pusher, and a duration",
                hint="give drive= and duration=, or read_experiments(table, scene=...) takes them"
                " from measurements",
            )
        return self

    def friction(self, a: str, b: str) -> float:
        """Coefficient of friction between two named bodies, one of them free at least [-]."""
        entry = self._entry(a, b)
        return entry.friction if entry else self._obstacle(a, b).friction

    def restitution(self, a: str, b: str) -> float:
        """Coefficient of restitution between two named bodies, one of them free at least [-]."""
        entry = self._entry(a, b)
        if entry and entry.restitution is not None:
            return entry.restitution
        if self._is_free(a) and self._is_free(b):
            return 0.0
        return self._obstacle(a, b).restitution

    def _entry(self, a: str, b: str) -> PairFriction | None:
        covering = [entry for entry in self.contact_friction if entry.covers(a, b)]
        return min(covering, key=lambda entry: not entry.is_literal, default=None)

    def _is_free(self, name: str) -> bool:
        return any(body.name == name for body in self.bodies)

    def _obstacle(self, a: str, b: str) -> Pusher | Fixel:
        for name in (a, b):
            check_name("the pair", name, self.names)
        pushers = [pusher for pusher in self.pushers if pusher.name in (a, b)]
        fixels = [fixel for fixel in self.fixels if fixel.name in (a, b)]
        obstacles: list[Pusher | Fixel] = [*pushers, *fixels]
        if a == b or len(obstacles) != 1:
            found, expected = f"{len(obstacles)} obstacles", "one free body and one pusher or fixel"
            raise InvalidInput(f"the pair {a!r} and {b!r}", found=found, expected=expected)
        return obstacles[0]


# Scene, file of one, or function that returns one for the conditions of an experiment.
SceneChoice = Scene | Path | Callable[[Mapping[str, str | float]], Scene]


def _two_names(pair: object) -> tuple[str, str]:
    where = "contact_friction.pair"
    if not isinstance(pair, list | tuple) or len(pair) != 2:
        raise InvalidInput(where, found=pair, expected="two names")
    return fields.name_of(pair[0], where), fields.name_of(pair[1], where)


def _members(values: T | Iterable[T], kind: type[T], where: str) -> tuple[T, ...]:
    fields.instance(values, kind | Iterable, where, f"a {kind.__name__}, or several")
    members = (values,) if isinstance(values, kind) else tuple(values)  # type: ignore[arg-type]
    for index, member in enumerate(members):
        fields.instance(member, kind, f"{where}[{index}]", f"a {kind.__name__}")
    return members


def check_push(
    scene: Scene, where: str = "scene", *, pushers: tuple[int, ...] = (1,), several: bool = False
) -> None:
    """Raise `InvalidInput` for a scene that is no push of one free body, or of `several`, by an
    allowed number of pushers."""
    n = len(scene.bodies)
    if n == 0 or (n > 1 and not several) or len(scene.pushers) not in pushers:
        raise InvalidInput(
            where,
            found=f"{n} free bodies and {len(scene.pushers)} pushers",
            expected=f"one free body{' or more' * several} and "
            f"{'at most ' * (0 in pushers)}one pusher",
        )


def _check_unique_names(names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            found = f"the name {name!r} twice"
            expected = "different names for all bodies, pushers and fixels"
            raise InvalidInput("scene", found=found, expected=expected)
        seen.add(name)


def _check_friction(scene: Scene) -> None:
    free = [body.name for body in scene.bodies]
    covered: BoolArray = np.eye(len(free), dtype=bool)
    for entry in scene.contact_friction:
        first, second = entry.named(free)
        covered |= np.outer(first, second) | np.outer(second, first)
    if not covered.all():
        a, b = (free[k] for k in np.argwhere(~covered)[0])
        found = f"no entry for the free bodies {a!r} and {b!r}"
        expected = "an entry for every pair of free bodies"
        hint = f"add {{pair: [{a}, {b}], friction: 0.3}}, or pair: ['*', '*'] for all at once"
        raise InvalidInput("contact_friction", found=found, expected=expected, hint=hint)


def _check_overlaps(scene: Scene) -> None:
    ready = [pusher for pusher in scene.pushers if not pusher.is_template]
    things: list[Body | Pusher | Fixel] = [*scene.bodies, *ready, *scene.fixels]
    box = boxes([x.shape for x in things], [x.pose for x in things])
    for i, j in pairs_of_boxes(box, len(scene.bodies)):
        a, b = things[i], things[j]
        depth = overlap_depth(a.shape, a.pose, b.shape, b.pose)
        size = float((box[[i, j], 2:] - box[[i, j], :2]).max())
        if depth > TOUCHING * size:
            raise InvalidInput(
                f"{a.name!r} and {b.name!r}",
                found=f"an overlap of {depth * 1e3:.4g} mm at the start",
                expected="bodies that do not overlap",
                hint="move one of them",
            )


def _is_pattern(name: str) -> bool:
    return any(mark in name for mark in "*?[")


def _matches(name: str, pattern: str) -> bool:
    return name == pattern or fnmatchcase(name, pattern)
