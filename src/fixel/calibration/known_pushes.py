"""Respects in which a push is unlike all experiments: its part, surface, laboratory, side, speed.

Parameters, errors and bounds that were learned from pushes hold for pushes like them. Every result
that uses them for another push reports what is unseen, by `KnownPushes.unseen`. A side that was
never pushed, or a speed, can be close to pushed ones in all features and still be unlike them in
what the side or the speed itself does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fixel.calibration.target import NUMBERING, TRUTH, Target, target_of
from fixel.errors import InvalidInput, check_name, some_of
from fixel.model import Disk, Experiment, Scene, Shape, rotated, wrapped
from fixel.model.fields import Comparable, frozen, instance, settle
from fixel.model.overlap import gaps_and_normals
from fixel.simulation.pack import pusher_path
from fixel.simulation.rollouts import RolloutCase
from fixel.typing import FloatArray, IntArray

# A contact is new where it differs by more than this from every pushed one of the part.
MAX_TURN: Final = float(np.radians(20.0))  # of the outline's normal, in the frame of the part [rad]
MAX_DISTANCE: Final = 0.5  # along the outline, in radii of a disk of the part's area [-]
MAX_RATIO: Final = 1.25  # of speeds [-]

# The condition of an experiment that says where the pusher stands around the part.
CONTACT_ANGLE: Final = "contact_angle_rad"

SIDE: Final = "side"
SPEED: Final = "speed"
BOTH: Final = "side and speed"
PART: Final = "part"


class Configurations(NamedTuple):
    """Intended straight pushes of one object by a round pusher."""

    shape: Shape
    radius: float  # radius of the pusher [m]
    start: FloatArray  # (n, 3) pose of the object [m, m, rad]
    tip_start: FloatArray  # (n, 2) centre of the pusher [m]
    tip_end: FloatArray  # (n, 2)


class TouchedPlaces(NamedTuple):
    """Places and speeds at which pushers touch parts."""

    # (n,) Direction of the outward normal at the contact, in the frame of the part [rad].
    normal: FloatArray
    # (n, 2) Contact point from the centroid, in the frame of the part, in radii of a disk of the
    # same area [-].
    place: FloatArray
    speed: FloatArray  # (n,) speed of the pusher [m/s]

    def rows(self, which: IntArray) -> TouchedPlaces:
        """Return some of them."""
        return TouchedPlaces(self.normal[which], self.place[which], self.speed[which])

    @classmethod
    def joined(cls, parts: Sequence[TouchedPlaces]) -> TouchedPlaces:
        """Return several tables as one."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def contacts_of(asked: Configurations, speed: FloatArray) -> TouchedPlaces:
    """Return the first contact of straight pushes at speeds (n,) [m/s]."""
    gap, normal = gaps_and_normals(asked.shape, asked.radius, asked.start, asked.tip_start)
    point = asked.tip_start - (asked.radius + gap)[:, None] * normal - asked.start[:, :2]
    normal, point = (rotated(own, -asked.start[:, 2]) for own in (normal, point))
    place = (point - np.asarray(asked.shape.centroid)) / np.sqrt(asked.shape.area / np.pi)
    return TouchedPlaces(np.arctan2(normal[:, 1], normal[:, 0]), place, np.asarray(speed))


class PushedContacts:
    """Contacts that have been pushed, by the label of their part.

    Pushes of one part are no data for another.
    """

    def __init__(self, contacts: TouchedPlaces, parts: Sequence[Hashable]) -> None:
        _check(contacts, len(parts))
        rows: dict[Hashable, list[int]] = {}
        for k, part in enumerate(parts):
            rows.setdefault(part, []).append(k)
        self._known = {part: contacts.rows(np.array(own)) for part, own in rows.items()}

    def novelty(self, contacts: TouchedPlaces, parts: Sequence[Hashable]) -> list[tuple[str, str]]:
        """Return what is new about each of other contacts, and the same as a sentence.

        It is `"side"`, `"speed"`, `"side and speed"` or `"part"`, and empty for contacts like
        pushed ones.
        """
        _check(contacts, len(parts))
        return [self._one(contacts.rows(np.array([k])), part) for k, part in enumerate(parts)]

    def _one(self, asked: TouchedPlaces, part: Hashable) -> tuple[str, str]:
        known = self._known.get(part)
        if known is None:
            return PART, "no experiment with this part"
        turn = np.abs(wrapped(known.normal - asked.normal))
        away = np.linalg.norm(known.place - asked.place, axis=1)
        speed = float(asked.speed[0])
        fast = (known.speed <= MAX_RATIO * speed) & (speed <= MAX_RATIO * known.speed)
        on_side = turn <= MAX_TURN
        near = on_side & (away <= MAX_DISTANCE)
        if (near & fast).any():
            return "", ""
        said = []
        if not on_side.any():
            apart = np.degrees(turn.min())
            said.append(
                f"side never pushed: its normal is {apart:.0f} degrees from those of all pushed "
                "sides"
            )
        elif not near.any():
            apart = away[on_side].min()
            said.append(
                f"contact point never pushed: {apart:.2g} part radii from all pushes on this side"
            )
        at_speed = f"{1e3 * speed:.3g} mm/s"
        if not fast.any():
            nearest = 1e3 * known.speed[np.abs(np.log(known.speed / speed)).argmin()]
            said.append(f"speed never pushed: {at_speed}, nearest {nearest:.3g} mm/s")
        if not said:
            said.append(f"side never pushed at {at_speed}")
        kind = BOTH if len(said) == 2 else SPEED if near.any() else SIDE
        return kind, "; ".join(said)


def _check(contacts: TouchedPlaces, n: int) -> None:
    shapes = (contacts.normal.shape, contacts.place.shape, contacts.speed.shape)
    if shapes != ((n,), (n, 2), (n,)):
        raise InvalidInput(
            "contacts", found=f"shapes {shapes}", expected=f"({n},), ({n}, 2), ({n},)"
        )
    if not all(np.isfinite(column).all() for column in contacts):
        raise InvalidInput(
            "contacts", found="numbers that are not finite", expected="finite numbers"
        )
    if (contacts.speed <= 0.0).any():
        raise InvalidInput("contacts.speed", found="0 or less", expected="positive speeds [m/s]")


PARTS: Final = ("shape", "part", "object", "object_id")
SURFACES: Final = ("surface", "table")
DATASET: Final = "dataset"
# Conditions that identify what errors depend on; every one of their values counts.
IDENTITY: Final = (*PARTS, *SURFACES, DATASET)


def check_conditions(experiments: Sequence[Experiment | Target], **names: str | None) -> None:
    """Raise for a named condition, by the argument with its name, that no experiment has."""
    known = sorted({name for own in experiments for name in own.conditions})
    for where, name in names.items():
        if name:
            check_name(where, name, known)


TRAVEL_LENGTH: Final = "travel"
# Experiments with one value below which it counts as unseen: one or two pushes are no evidence.
MIN_EXPERIMENTS: Final = 3
MAX_NAMES: Final = 5  # values that a sentence lists
ALIKE: Final = 0.02  # largest relative difference of the sizes of one part's outlines
PLACES: Final = 64  # of the pusher along its path, among which its first contact is searched
TOUCHING: Final = 2e-3  # [m] gap at the start below which the pusher already touches the part


class Trait(NamedTuple):
    """Trait of a push that no experiment has: its part, side, speed or another condition."""

    # Name of a condition, or `"part"`, `"side"`, `"speed"`, `"side and speed"` or `"travel"`.
    what: str
    text: str  # sentence with the value of the push and those of the experiments
    is_given: bool = True  # false for a condition that the experiments have and the push lacks


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownPushes(Comparable):
    """Parts, surfaces, laboratories, contacts, speeds and travels of experiments."""

    keys: tuple[str, ...]  # names of the experiments
    # Values of the conditions that are labels, one per experiment; empty if it has none.
    labels: Mapping[str, tuple[str, ...]]
    size: FloatArray  # (n, 2) root of the area and radius of gyration of the part's outline [m]
    # (n, 4) Direction of the normal [rad], place x, y [-] and speed [m/s] of the first contact, as
    # in `TouchedPlaces`; nan without a moving pusher.
    contact: FloatArray
    travel: FloatArray  # (n,) travel of the pusher [m]; nan without a moving pusher

    def __post_init__(self) -> None:
        settle(
            self,
            keys=tuple(self.keys),
            labels={name: tuple(column) for name, column in self.labels.items()},
            size=frozen(self.size),
            contact=frozen(self.contact),
            travel=frozen(self.travel),
        )

    @classmethod
    def of(cls, targets: Sequence[Target], names: Sequence[str] = ()) -> Self:
        """Return what experiments have in common with pushes to come.

        Conditions in `names` count as labels in addition to the usual ones.
        """
        rows = [_labels(target, names) for target in targets]
        columns = {
            name: tuple(row.get(name, "") for row in rows)
            for name in dict.fromkeys(name for row in rows for name in row)
        }
        pushes = [_push(target.case.scene, float(target.case.times[-1])) for target in targets]
        return cls(
            keys=tuple(target.key for target in targets),
            labels={
                name: column
                for name, column in columns.items()
                if name in (*IDENTITY, *names) or _repeats(column)
            },
            size=np.array([_size(target.case.scene) for target in targets]).reshape(-1, 2),
            contact=np.array([own[:4] for own in pushes]).reshape(-1, 4),
            travel=np.array([own[4] for own in pushes]),
        )

    def __len__(self) -> int:
        return len(self.travel)

    def has_outline(self, scene: Scene) -> bool:
        """Return whether an experiment has a part with the outline of a scene's body."""
        return bool(self._same_outline(scene).any())

    def texts(self, target: Target) -> tuple[str, ...]:
        """Return sentences on what is new about a push; none for one of the experiments."""
        return () if target.key in self.keys else texts_of(self.unseen(target))

    def unseen(self, target: Target) -> tuple[Trait, ...]:
        """Return the respects in which a push is unlike all experiments; empty for none.

        A side, a speed and a travel count as seen only on the same part, surface and laboratory.
        """
        given = _labels(target, tuple(self.labels))
        same_outline = self._same_outline(target.case.scene)
        found = [*self._new_labels(given), *self._missing_labels(given, same_outline)]
        if not same_outline.any() and not any(own.what in PARTS for own in found):
            found.insert(0, Trait(PART, "part: its outline is unlike those of all experiments"))
        known = {name: given[name] for name in IDENTITY if given.get(name) and name in self.labels}
        if any(own.is_given for own in found):
            return tuple(found)
        rows = self._rows(known)
        if not len(rows):
            text = " and ".join(f"{name} {value!r}" for name, value in known.items())
            what = next((name for name in known if name not in PARTS), next(iter(known)))
            return (Trait(what, f"{text}: no experiment with all of these"), *found)
        if not same_outline[rows].any():
            text = "part: its outline is unlike those of all experiments with its name"
            return (Trait(PART, text), *found)
        return (*self._new_contact(target.case.scene, target, rows), *found)

    def _new_labels(self, given: Mapping[str, str]) -> Iterator[Trait]:
        for name, counts in self._counts.items():
            value = given.get(name, "")
            n = counts[value]
            least = min(MIN_EXPERIMENTS, len(self)) if name in IDENTITY else 1
            if value and not n:
                known = some_of(sorted(counts), MAX_NAMES)
                yield Trait(name, f"{name} {value!r}: no experiment with it, only {known}")
            elif value and n < least:
                yield Trait(name, f"{name} {value!r}: only {n} of {len(self)} experiments with it")

    def _missing_labels(self, given: Mapping[str, str], same: np.ndarray) -> Iterator[Trait]:
        for name in (*PARTS, *SURFACES):
            if given.get(name) and name not in self.labels:
                text = f"{name} {given[name]!r}: the experiments do not state theirs"
                yield Trait(name, text, is_given=False)
        for name, column in self.labels.items():
            counts = self._counts[name]
            if given.get(name) or name not in IDENTITY:
                continue
            if name == DATASET and len(counts) < 2:
                continue  # a scene alone belongs to no laboratory
            if name in PARTS and len({column[k] for k in np.flatnonzero(same)}) == 1:
                continue  # the outline identifies the part
            known = some_of(sorted(counts), MAX_NAMES)
            yield Trait(name, f"{name} not given (experiments have {known})", False)

    @cached_property
    def _counts(self) -> dict[str, Counter[str]]:
        return {name: Counter(filter(None, column)) for name, column in self.labels.items()}

    @cached_property
    def _columns(self) -> dict[str, NDArray[np.str_]]:
        return {name: np.array(column) for name, column in self.labels.items()}

    def _rows(self, labels: Mapping[str, str]) -> IntArray:
        good = np.ones(len(self), bool)
        for name, value in labels.items():
            good &= self._columns[name] == value
        return np.flatnonzero(good)

    def _same_outline(self, scene: Scene) -> np.ndarray:
        own = np.array(_size(scene))
        return np.asarray((np.abs(self.size - own) <= ALIKE * own).all(axis=1))

    def _new_contact(self, scene: Scene, target: Target, rows: IntArray) -> Iterator[Trait]:
        *contact, travel = _push(scene, float(target.case.times[-1]))
        rows = rows[np.isfinite(self.contact[rows]).all(axis=1)]
        if not np.isfinite(contact).all():
            return
        if not len(rows):
            yield Trait("side", "side: no experiment with a moving pusher")
            return
        pushed = PushedContacts(_places(self.contact[rows]), [0] * len(rows))
        ((kind, reason),) = pushed.novelty(_places(np.array([contact])), [0])
        if kind:
            yield Trait(kind, reason)
        low, high = self.travel[rows].min(), self.travel[rows].max()
        if not low / MAX_RATIO <= travel <= MAX_RATIO * high:
            shown = f"{1e3 * low:.3g}" if low == high else f"{1e3 * low:.3g} to {1e3 * high:.3g}"
            yield Trait(
                TRAVEL_LENGTH, f"travel never pushed: {1e3 * travel:.3g} mm, only {shown} mm"
            )


def texts_of(unseen: Sequence[Trait]) -> tuple[str, ...]:
    """Return the sentences, those of new values first."""
    return tuple(own.text for own in sorted(unseen, key=lambda own: not own.is_given))


def push_target(what: Scene | Experiment, conditions: Mapping[str, str | float]) -> Target:
    """Return the target of a scene or experiment, with more conditions."""
    if isinstance(what, Experiment):
        own = target_of(what)
        return own._replace(conditions={**own.conditions, **conditions})
    instance(what, Scene, "scene", "a Scene or an Experiment")
    case = RolloutCase(what, np.array([what.duration]))
    return Target("scene", dict(conditions), case, np.zeros((0, 3)))


def with_dataset(target: Target) -> Target:
    """Return a target with its laboratory (dataset) among the conditions."""
    dataset, slash, _ = target.key.partition("/")
    own = {DATASET: dataset} if slash else {}
    return target._replace(conditions={**own, **target.conditions})


def with_units(targets: Sequence[Target], name: str) -> list[Target]:
    """Return targets with a condition whose values are left out as a whole.

    Experiments that lack `"dataset"`, `"side"` or `"speed"` have it computed. A side and a speed
    are those of one part.
    """
    targets = [with_dataset(target) for target in targets]
    if name not in (SIDE, SPEED) or any(name in target.conditions for target in targets):
        return targets
    known = KnownPushes.of(targets)
    columns = [known.labels[own] for own in IDENTITY if own in known.labels]
    parts = [
        " ".join(filter(None, (*(column[k] for column in columns), f"{1e3 * size:.3g} mm")))
        for k, size in enumerate(known.size[:, 0].tolist())
    ]
    label = np.array([""] * len(targets), object)
    for part in dict.fromkeys(parts):
        own = np.flatnonzero(np.array([other == part for other in parts]))
        value = known.contact[own, 0 if name == SIDE else 3]
        number = _sides(value) if name == SIDE else _speeds(value)
        label[own] = [f"{part} {name} {k + 1}" for k in number.tolist()]
    return [
        target._replace(conditions={**target.conditions, name: text})
        for target, text in zip(targets, label.tolist(), strict=True)
    ]


def _sides(normal: FloatArray) -> IntArray:
    """Number sides (n,) by their normals [rad]: quarters of directions between wide gaps."""
    order = np.argsort(normal)
    turn = np.diff(normal[order], append=normal[order[:1]] + 2.0 * np.pi)
    order = np.roll(order, -1 - int(turn.argmax()))  # begin after the widest gap
    along = (normal[order] - normal[order[0]]) % (2.0 * np.pi)
    number, first = np.zeros(len(normal), np.int64), along[0]
    for k in range(1, len(order)):
        wide = along[k] - along[k - 1] > MAX_TURN or along[k] - first > 0.5 * np.pi
        number[order[k]] = number[order[k - 1]] + wide
        first = along[k] if wide else first
    return number


def _speeds(speed: FloatArray) -> IntArray:
    """Number speeds (n,), which differ by more than `MAX_RATIO`."""
    order = np.argsort(speed)
    step = np.diff(speed[order], prepend=speed[order[:1]]) > 0.0
    step[1:] &= speed[order][1:] > MAX_RATIO * speed[order][:-1]
    number = np.empty(len(speed), np.int64)
    number[order] = np.cumsum(step)
    return number


def _labels(target: Target, names: Sequence[str]) -> dict[str, str]:
    """Conditions that are labels: identities, texts, and those that are named."""
    return {
        name: f"{value:g}" if isinstance(value, float) else str(value)
        for name, value in with_dataset(target).conditions.items()
        if name not in NUMBERING
        and not name.startswith(TRUTH)
        and (isinstance(value, str) or name in (*IDENTITY, *names))
    }


def _repeats(column: Sequence[str]) -> bool:
    """Whether most values of a text occur more than once, so that it groups experiments."""
    counts = Counter(filter(None, column))
    return 2 * sum(n for n in counts.values() if n > 1) > len(column)


def _size(scene: Scene) -> tuple[float, float]:
    shape = scene.bodies[0].shape
    return float(np.sqrt(shape.area)), float(np.sqrt(shape.unit_inertia))


def _places(rows: FloatArray) -> TouchedPlaces:
    return TouchedPlaces(rows[:, 0], rows[:, 1:3], rows[:, 3])


def _push(scene: Scene, duration: float) -> tuple[float, float, float, float, float]:
    """Return normal, place and speed of the first contact of a push, and its travel."""
    nothing = (np.nan,) * 5
    if not scene.pushers:
        return nothing
    pusher, body = scene.pushers[0], scene.bodies[0]
    path = pusher_path(pusher, duration)
    steps = np.hypot(*np.diff(path[:, 1:3], axis=0).T)
    travel, seconds = float(steps.sum()), float(path[-1, 0] - path[0, 0])
    if not (travel > 0.0 and seconds > 0.0):
        return nothing
    shape = pusher.shape
    radius = shape.radius if isinstance(shape, Disk) else float(np.sqrt(shape.area / np.pi))
    way = np.concatenate((np.zeros(1), np.cumsum(steps)))
    at = np.linspace(0.0, travel, PLACES)
    tip = np.column_stack([np.interp(at, way, path[:, k]) for k in (1, 2)])
    start = body.pose[None]
    gap, _ = gaps_and_normals(body.shape, radius, start, tip[:1])
    first = 0
    if gap[0] > TOUCHING:
        gap, _ = gaps_and_normals(body.shape, radius, np.repeat(start, PLACES, axis=0), tip)
        touched = np.flatnonzero(gap <= 0.0)
        first = int(touched[0]) if len(touched) else int(gap.argmin())
    one = Configurations(body.shape, radius, start, tip[first][None], tip[-1:])
    found = contacts_of(one, np.array([travel / seconds]))
    x, y = found.place[0].tolist()
    return float(found.normal[0]), x, y, travel / seconds, travel
