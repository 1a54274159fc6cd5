"""Scenes that another engine simulates many times with varying parameters."""

from __future__ import annotations

import statistics
import time
import weakref
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fixel.errors import FixelError, InvalidInput, SolveFailed, check_name
from fixel.kernels import codes
from fixel.model import Parameters, Scene
from fixel.simulation.engines import EngineName, program_of, shared_program, silent
from fixel.simulation.engines.contract import EngineInfo, fault
from fixel.simulation.engines.program import Program, ProgramFailed, text_of
from fixel.simulation.engines.task import plain, pusher_poses, task_of, unsupported
from fixel.simulation.motion import OtherEngine
from fixel.simulation.result import CONTACT_FIELDS
from fixel.simulation.rollouts import INFEASIBLE, EnsembleOutcome, RolloutCase
from fixel.simulation.threads import awaited, cores
from fixel.simulation.vary import infeasible
from fixel.typing import FloatArray, IntArray

FIRST_LIMIT = 60.0  # [s] for a rollout of a case that was not simulated before
LEAST_LIMIT = 5.0  # [s] for later ones
SLOWER = 20.0  # longest time of a rollout over the median of its case
REMEMBERED = 32  # rollouts of a case whose times count
GIVE_UP = 10  # lost programs in a row, without an answer between them, that end the work
PER_PASS = 256  # rollouts whose poses are held at once
SAMPLES = 100  # where no output interval is given: an engine's own steps are not known


class EngineEnsemble:
    """Set of scenes that another engine simulates, with the interface of `Ensemble`.

    The engine runs in `threads` processes of its own, by default one for each core, or in those of
    `programs`, which stay when the ensemble ends. One that hangs, ends or answers nonsense costs
    one rollout, which fails with its reason, and is started again. A rollout may take `limit` [s],
    by default 20 times the median of its case. The stepper is ignored: the step is a choice of the
    engine.
    """

    def __init__(
        self,
        cases: Sequence[RolloutCase],
        motion: OtherEngine,
        stepper: Any = None,
        threads: int | None = None,
        *,
        limit: float | None = None,
        programs: Sequence[Program] = (),
    ) -> None:
        if not cases:
            raise InvalidInput("cases", found="none", expected="at least one")
        for case in cases:
            if found := unsupported(case.scene):
                raise _refused(motion.name, found)
        self.cases, self.motion, self.stepper = tuple(cases), motion, stepper
        self._limit = limit
        self._times: dict[int, deque[float]] = defaultdict(lambda: deque(maxlen=REMEMBERED))
        self._lost = 0
        self._programs = list(programs)
        if not programs:
            self._programs = [program_of(motion.name) for _ in range(threads or cores())]
            weakref.finalize(self, _close, self._programs)
        self.info = self._greeted()

    @property
    def n_sample(self) -> int:
        """Number of samples of the case that has the most."""
        return max(len(case.times) for case in self.cases)

    def simulate(
        self, which: IntArray, values: Mapping[str, FloatArray], fixels: FloatArray | None = None
    ) -> EnsembleOutcome:
        """Simulate cases under parameters, as `Ensemble.simulate`; forces are not known: zero."""
        n = len(which)
        starts = np.array([self.cases[k].scene.bodies[0].pose for k in which]).reshape(n, 3)
        pose = np.repeat(starts[:, None], self.n_sample, axis=1)

        def store(rollouts: IntArray, found: FloatArray) -> None:
            pose[rollouts] = found

        status, reasons = self._run(store, which, values, fixels)
        ends = np.array([self.cases[k].times[-1] for k in which])
        reached = np.where(status == codes.CONVERGED, ends, 0.0)
        others = np.zeros((n, 0, 3))
        return EnsembleOutcome(
            status, pose, reached, np.zeros(n), np.zeros(n, bool), reasons, others
        )

    def simulate_into(
        self,
        use: Callable[[IntArray, FloatArray], None],
        which: IntArray,
        values: Mapping[str, FloatArray],
    ) -> tuple[NDArray[np.bool_], list[str]]:
        """Simulate cases under parameters, and pass their poses on, as `Ensemble.simulate_into`."""
        status, reasons = self._run(use, which, values, None)
        return np.equal(status, codes.CONVERGED), reasons

    def refused(self, which: IntArray, values: Mapping[str, FloatArray]) -> list[str]:
        """Reasons why rollouts of cases `which` (n,) are infeasible; empty for feasible ones."""
        reasons = [""] * len(which)
        shared, own = self._split(values)
        for name, column in own.items():
            info = self.info.parameters[name.partition(".")[2]]
            low = column <= info.lowest if info.above else column < info.lowest
            for k in np.flatnonzero(low):
                reasons[k] = f"{name} below its smallest value"
        if shared:
            for case in np.unique(which):
                rows = np.flatnonzero(which == case)
                scene = self.cases[case].scene
                found = infeasible(scene, {name: v[rows] for name, v in shared.items()})
                for k, reason in zip(rows, found, strict=True):
                    reasons[k] = reasons[k] or reason
        return reasons

    def close(self) -> None:
        """End the processes; the next call starts them again."""
        _close(self._programs)

    def _greeted(self) -> EngineInfo:
        """Return name, version and parameters of the engine; raise for a wrong version."""
        wanted = EngineName.of(self.motion.name)
        try:
            info = self._programs[0].info()
        except ProgramFailed as failure:
            raise silent(wanted.name, failure) from None
        if wanted.version and info.version != wanted.version:
            found = f"version {info.version}"
            expected = f"version {wanted.version}"
            hint = f"install that version, or choose {wanted._replace(version='')}"
            raise InvalidInput(f"engine {wanted.name}", found=found, expected=expected, hint=hint)
        return info

    def _split(
        self, values: Mapping[str, FloatArray]
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Separate fixel's parameters from those of the engine; raise for another engine's."""
        shared = {name: v for name, v in values.items() if "." not in name}
        own = {name: v for name, v in values.items() if "." in name}
        known = {f"{self.info.name}.{name}" for name in self.info.parameters}
        for name in own:
            check_name("parameters", name, known)
        return shared, own

    def _run(
        self,
        use: Callable[[IntArray, FloatArray], None],
        which: IntArray,
        values: Mapping[str, FloatArray],
        fixels: FloatArray | None,
    ) -> tuple[IntArray, list[str]]:
        reasons = self.refused(which, values)
        status = np.full(len(which), INFEASIBLE, np.int64)
        free: SimpleQueue[Program] = SimpleQueue()
        for program in self._programs:
            free.put(program)
        done: SimpleQueue[tuple[int, tuple[FloatArray | None, str] | BaseException]] = SimpleQueue()

        def work(k: int) -> None:
            program = free.get()
            try:
                own = {name: float(column[k]) for name, column in values.items()}
                fixed = None if fixels is None else fixels[k]
                done.put((k, self._rollout(program, int(which[k]), own, fixed)))
            except BaseException as problem:
                done.put((k, problem))
            finally:
                free.put(program)

        ready = np.flatnonzero([not reason for reason in reasons])
        workers = ThreadPoolExecutor(len(self._programs), thread_name_prefix="fixel-engine")
        try:
            for first in range(0, len(ready), PER_PASS):
                part = ready[first : first + PER_PASS]
                for k in part.tolist():
                    workers.submit(work, k)
                poses = {}
                for _ in part:
                    k, answer = awaited(done)
                    if isinstance(answer, BaseException):
                        raise answer
                    pose, reason = answer
                    status[k] = codes.ENGINE_FAILED if reason else codes.CONVERGED
                    reasons[k] = reason and f"{self.info.name}: {reason}"
                    if pose is not None:
                        poses[k] = pose
                if good := sorted(poses):
                    use(np.array(good), self._padded([poses[k] for k in good]))
        except BaseException:
            # Ctrl-C, or an engine that is given up: what runs is ended, what waits never starts.
            workers.shutdown(wait=False, cancel_futures=True)
            self.close()
            raise
        workers.shutdown()
        return status, reasons

    def _rollout(
        self, program: Program, case: int, values: Mapping[str, float], fixels: FloatArray | None
    ) -> tuple[FloatArray | None, str]:
        """Simulate a case once; return the checked poses (n, 3) of the body, or None and why."""
        task, scene_poses = task_of(
            self.cases[case].scene,
            self.cases[case].times,
            {name: value for name, value in values.items() if "." not in name},
            {name.partition(".")[2]: value for name, value in values.items() if "." in name},
            fixels,
        )
        answer, reason = self._answer(program, case, plain(task))
        reason = reason or fault(task, answer)
        return None if reason else scene_poses(np.array(answer, np.float64)), reason

    def _answer(self, program: Program, case: int, task: Any) -> tuple[Any, str]:
        """Return the poses of one rollout, or the reason why there are none."""
        times = self._times[case]
        usual = max(LEAST_LIMIT, SLOWER * statistics.median(times)) if times else FIRST_LIMIT
        begin = time.monotonic()
        try:
            answer = program.ask({"task": task}, self._limit or usual)
        except ProgramFailed as failure:
            self._lost += 1
            if self._lost >= GIVE_UP:
                raise SolveFailed(
                    f"the engine {self.info.name} was lost {GIVE_UP} times in a row: {failure}"
                ) from None
            return None, str(failure)
        self._lost = 0
        times.append(time.monotonic() - begin)
        if "refused" in answer:
            raise _refused(self.info.name, text_of(answer["refused"]))
        if "failed" in answer:
            return None, text_of(answer["failed"])
        return answer.get("pose"), ""

    def _padded(self, poses: Sequence[FloatArray]) -> FloatArray:
        """Stack poses, the last one repeated where a case has fewer samples."""
        place = np.arange(self.n_sample)
        return np.array([p[np.minimum(place, len(p) - 1)] for p in poses])


def fields_of_engine(
    scene: Scene,
    engine: OtherEngine,
    parameters: Parameters | None,
    duration: float,
    times: FloatArray | None,
) -> dict[str, Any]:
    """Return the fields of a `Simulation` by another engine; forces and contacts are not known."""
    times = np.linspace(0.0, duration, SAMPLES + 1) if times is None else times
    case = RolloutCase(scene, times[1:])
    values = {name: np.array([value]) for name, value in (parameters or {}).items()}
    ensemble = EngineEnsemble([case], engine, programs=[shared_program(engine.name)])
    stated = EngineName.of(engine.name)._replace(version=ensemble.info.version)
    seconds = time.perf_counter()
    outcome = ensemble.simulate(np.zeros(1, np.int64), values)
    seconds = time.perf_counter() - seconds
    shared = {name: value for name, value in (parameters or {}).items() if "." not in name}
    task, scene_poses = task_of(scene, times, shared, {})
    start = scene_poses(task.body.start)[None]
    converged = bool(outcome.converged[0])
    if not converged:
        times = times[:1]
    track = np.concatenate((start, outcome.pose[0]))[: len(times)]
    pose = {scene.bodies[0].name: track}
    for pusher in scene.pushers:
        assert task.pusher is not None
        pose[pusher.name] = pusher_poses(task.pusher, times)
    return {
        "status": codes.STATUS_NAMES[codes.CONVERGED if converged else codes.ENGINE_FAILED],
        "stopped_at": None if converged else 0.0,
        "duration": duration if converged else 0.0,
        "time": times,
        "pose": pose,
        "twist": {
            name: np.gradient(own, times, axis=0) if len(times) > 1 else np.zeros_like(own)
            for name, own in pose.items()
        },
        "contacts": np.zeros(0, CONTACT_FIELDS),
        "pushers": {},
        "steps": 0,
        "fallbacks": 0,
        "max_residual": 0.0,
        "wall_time_s": seconds,
        "method": {
            "motion": str(stated),
            "engine": f"{stated.name} {stated.version}".strip(),
            "stepper": "its own",
            "solver": "its own",
            **({} if converged else {"reason": outcome.reasons[0]}),
        },
    }


def _refused(engine: str, found: str) -> FixelError:
    return InvalidInput(
        f"engine {engine}",
        found=found,
        expected="a scene that the engine can represent",
        hint="simulate it by fixel's own engine, or change the scene",
    )


def _close(programs: Sequence[Program]) -> None:
    for program in programs:
        program.close()
