"""Motion models: equations of motion of the bodies.

Each model has two functions: `assemble` writes a body's own rows of the step problem, `move` takes
the step once it is solved. The three built-in models also have an integer code for the compiled
loop.
"""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar, NoReturn, TypeVar, final

from fixel.engine_names import EngineName, engine_names, is_engine
from fixel.errors import InvalidInput, unknown_name
from fixel.kernels import codes, entries
from fixel.kernels.arrays import Model, Problem, State
from fixel.model.fields import instance
from fixel.typing import FloatArray


class AbstractMotionModel(abc.ABC):
    """Abstract motion model, which writes the rows of the free bodies and moves them."""

    name: ClassVar[str]
    kind: ClassVar[int] = codes.EXTERNAL

    @abc.abstractmethod
    def assemble(
        self, model: Model, state: State, step: float, pose: FloatArray, problem: Problem
    ) -> int:
        """Write inertia, momentum and support friction of every free body.

        Parameters
        ----------
        model, state
            Scaled model and state, see `fixel.kernels.arrays`.
        step : float
            Scaled time over which forces act: the step, or half of it where the unknown velocity is
            that of its middle.
        pose : (n_body, 3) float64
            Configuration at which rows are taken.
        problem : Problem
            Receives `inertia`, `momentum` and the first `element_...` rows.

        Returns
        -------
        int
            Number of support friction elements written.
        """

    @abc.abstractmethod
    def move(
        self, model: Model, state: State, step: float, problem: Problem, extrapolation: int
    ) -> None:
        """Take the step: velocities become the problem's, poses follow.

        `extrapolation` is 0 where the problem's velocities are those of the step's end. Where they
        are those of its middle, it is 2 if they changed smoothly, else 1.
        """


class _BuiltInMotion(AbstractMotionModel):
    """Motion model with a code for the kernels."""

    def assemble(
        self, model: Model, state: State, step: float, pose: FloatArray, problem: Problem
    ) -> int:
        return int(entries.assemble(model, state, self.kind, step, pose, problem))

    def move(
        self, model: Model, state: State, step: float, problem: Problem, extrapolation: int
    ) -> None:
        entries.move_bodies(model, state, step, problem, extrapolation)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Dynamic(_BuiltInMotion):
    """Newton's law with impulses: ``M (v' - v) = h f + impulses``.

    For slow pushing of very light parts, where inertia is negligible, use
    `QuasiStatic`.

    References
    ----------
    :cite:t:`stewart1996`, eqs. 6-10; support friction as in :cite:t:`rpi2011`, eqs. 2.13-2.14.

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), motion=Dynamic()).method["motion"]
    'dynamic'
    """

    name: ClassVar[str] = "dynamic"
    kind: ClassVar[int] = codes.DYNAMIC


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class QuasiStatic(_BuiltInMotion):
    """Balance of forces at every instant: ``0 = h f + impulses``.

    A body without contacts is at rest. The path is independent of speeds, masses and the friction
    of the plane (ASME 2006). Every free body needs support friction.

    References
    ----------
    :cite:t:`asme2006`, eqs. 1-2.

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), motion="quasistatic").method["motion"]
    'quasistatic'
    """

    name: ClassVar[str] = "quasistatic"
    kind: ClassVar[int] = codes.QUASI_STATIC


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FirstOrder(_BuiltInMotion):
    """Velocity from the limit surface: ``v' = mobility @ wrench``, the ellipsoid's normal.

    The wrench is not bounded by the surface, so that bodies never stick: a smooth approximation of
    `QuasiStatic`, and a good first guess. Every free body needs support friction, whose ellipsoid
    gives the mobility.

    References
    ----------
    Halm & Posa (2019), eq. 3, with the ellipsoid of :cite:t:`howe1996`.

    Examples
    --------
    >>> from fixel.simulation import simulate
    >>> from fixel.testing.scenes import pushed_square
    >>> simulate(pushed_square(), motion=FirstOrder()).converged
    True
    """

    name: ClassVar[str] = "first-order"
    kind: ClassVar[int] = codes.FIRST_ORDER


@dataclass(frozen=True, slots=True)
class OtherEngine(AbstractMotionModel):
    """Another simulator, instead of fixel's own equations of motion.

    Parameters
    ----------
    name : str
        Engine, with a version and choices if wanted, such as ``"mujoco==4.0.0:step=0.001"``; or the
        path of a program.

    Examples
    --------
    >>> OtherEngine("pymunk:iterations=30").name
    'pymunk:iterations=30'
    """

    name: str  # type: ignore[misc]

    def assemble(self, *rows: Any, **options: Any) -> NoReturn:
        expected = "a motion model of fixel: this needs contacts, forces or many bodies"
        raise InvalidInput("motion", found=f"the engine {self.name}", expected=expected)

    move = assemble


Part = TypeVar("Part")
MOTION_MODELS: tuple[type[AbstractMotionModel], ...] = (Dynamic, QuasiStatic, FirstOrder)


def motion_model(motion: AbstractMotionModel | str | None) -> AbstractMotionModel:
    """Return a motion model, also by its name, or another engine; the dynamic one for None."""
    if isinstance(motion, str | None) and not motion:
        return Dynamic()
    instance(motion, AbstractMotionModel | str | type, "motion", "a motion model, or its name")
    own = [model.name for model in MOTION_MODELS]
    if isinstance(motion, str) and motion not in own:
        if is_engine(motion):
            return OtherEngine(motion)
        known = [*own, *engine_names()]
        raise unknown_name(
            "motion", EngineName.of(motion).name, known, more=", or the path of a program"
        )
    return named_part(motion, MOTION_MODELS, "motion")


def stated_name(motion: AbstractMotionModel | str) -> str:
    """Return the name under which a motion model, or an engine with its version, is stored."""
    model = motion_model(motion)
    name = motion if isinstance(motion, str) else model.name
    if isinstance(model, OtherEngine):
        # Only for another engine: this loads what the others need.
        name = import_module("fixel.simulation.engines").stated(name)
    return name


def named_part(part: Part | str, family: Sequence[type[Part]], where: str) -> Part:
    """Return a part of a method, also by its name; raise for names outside its family."""
    if not isinstance(part, str):
        return part() if isinstance(part, type) else part  # of a class, its usual options
    for member in family:
        if getattr(member, "name", "") == part:
            return member()
    raise unknown_name(where, part, [str(getattr(member, "name", "")) for member in family])
