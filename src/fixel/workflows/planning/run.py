"""Plan pushes that reach a goal despite what is unknown."""

from __future__ import annotations

import io
from collections.abc import Iterator, MutableMapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Final, final

import numpy as np

from fixel.errors import Interrupted
from fixel.io.array_bytes import array_of
from fixel.io.journal import Journal
from fixel.model import Scene
from fixel.model.goals import Goal
from fixel.planning.belief import Belief
from fixel.planning.plan import PushPlan, find_plan
from fixel.planning.pushes import FreePushes, PlanPush, RigPush, RigPushes
from fixel.progress import ProgressOption, show_progress
from fixel.simulation.motion import AbstractMotionModel, motion_model
from fixel.simulation.simulate import SceneWithMethod, scene_file
from fixel.simulation.stepper import AbstractStepper
from fixel.simulation.trust import permit
from fixel.typing import FloatArray

ROLLOUTS: Final = 160_000
JOURNAL: Final = "answers.journal"


def plan(
    scene: Scene | SceneWithMethod | str | PathLike[str],
    goal: Goal,
    choose: FreePushes | RigPushes | None = None,
    belief: Belief | None = None,
    *,
    rollouts: int = ROLLOUTS,
    seed: int = 0,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    untrusted: bool = False,
    first: Sequence[Sequence[PlanPush | RigPush]] = (),
    threads: int | None = None,
    store: PathLike[str] | str | None = None,
    progress: ProgressOption = None,
) -> PushPlan:
    """Plan open-loop pushes that reach a goal despite what is unknown.

    Candidates are raced under common samples of what is unknown, the best are refined, and the
    success probability of the chosen plan is computed from samples that the search has not seen.

    Parameters
    ----------
    scene : Scene, scene file or path
        Part at its start, fixels, and perhaps the tool as the pusher.
    goal : Goal
        `PoseRegion`, `Seated`, `Inside`, `Beyond`, or a combination by `AllOf` and `AnyOf`.
    choose : FreePushes or RigPushes, optional
        What may be chosen; by default one push of a free tool.
    belief : Belief, optional
        What is unknown; by default nothing.
    rollouts : int
        Number of simulated pushes that the search may use. The same number, seed and version give
        the same plan to the last bit, for any number of threads.
    seed : int
    motion, stepper : optional
        Method of the simulations; by default that of the calibration, else quasi-static.
    untrusted : bool
        Whether pushes may be chosen that resemble none of the calibration's experiments.
    first : sequence of sequences of PlanPush or RigPush
        Plans that are tried besides those that the search finds.
    threads : int, optional
        Number of threads; all cores by default.
    store : path, optional
        Folder in which the work is stored as it is done; the same call continues it.
    progress : bool or callable, optional
        As for `fixel.calibrate`.

    Returns
    -------
    PushPlan

    Raises
    ------
    InvalidInput
        The goal cannot be reached, names what the scene does not have, or needs pushes that no
        experiment resembles.
    Interrupted
        After Ctrl-C; with `store`, the same call continues.

    Examples
    --------
    >>> from fixel import Belief, PoseRegion, StartError
    >>> from fixel.testing.scenes import pushed_square
    >>> from fixel.units import deg, mm
    >>> goal = PoseRegion((0.02, 0.0, 0.0), position=3 * mm, angle=4 * deg)
    >>> start = StartError(x=mm, y=mm, kind="uniform")
    >>> belief = Belief(parameters={"mu_pusher": (0.2, 0.4)}, start=start)
    >>> found = plan(pushed_square(), goal, belief=belief, rollouts=8_000, progress=False)
    >>> found.success.mean > 0.8
    True
    """
    permit(motion)
    if isinstance(scene, Scene):
        own = scene
    else:
        file = scene_file(scene, "a Scene or a scene file")
        own, motion, stepper = file.scene, motion or file.motion, stepper or file.stepper
    with show_progress(progress, "planning") as report, _answers(store) as answers:
        try:
            return find_plan(
                own, goal, choose or FreePushes(), belief or Belief(),
                rollouts=rollouts, seed=seed, threads=threads,
                motion=None if motion is None else motion_model(motion), stepper=stepper,
                untrusted=untrusted, first=first, answers=answers, report=report.show,
            )  # fmt: skip
        except KeyboardInterrupt:
            hint = "the same call continues" if store else "with store='FOLDER' it would continue"
            raise Interrupted(None, hint) from None


@contextmanager
def _answers(store: PathLike[str] | str | None) -> Iterator[MutableMapping[str, FloatArray]]:
    if store is None:
        yield {}
        return
    folder = Path(store)
    folder.mkdir(parents=True, exist_ok=True)
    with Journal(folder / JOURNAL) as journal:
        yield _StoredAnswers(journal)


@final
class _StoredAnswers(MutableMapping[str, FloatArray]):
    """Arrays by name in a journal, each durable once it is set."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal

    def __getitem__(self, name: str) -> FloatArray:
        data = self._journal.get(name)
        if data is None:
            raise KeyError(name)
        answer: FloatArray = array_of(data)
        return answer

    def __setitem__(self, name: str, array: FloatArray) -> None:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        self._journal.append([(name, stream.getvalue())])

    def __delitem__(self, name: str) -> None:
        raise TypeError("answers are not deleted")

    def __iter__(self) -> Iterator[str]:
        return iter(self._journal)

    def __len__(self) -> int:
        return len(self._journal)
