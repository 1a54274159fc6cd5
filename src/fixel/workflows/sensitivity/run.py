"""Compute the sensitivity of pushes to their start, and order them by it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Seed, Threads, Values
from fixel.errors import InvalidInput
from fixel.units import deg, mm

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.model import Experiment, Scene
    from fixel.progress import ProgressOption
    from fixel.simulation import AbstractMotionModel
    from fixel.simulation.simulate import SceneWithMethod
    from fixel.simulation.stepping import AbstractStepper
    from fixel.uncertainty.error_terms import StartError
    from fixel.uncertainty.outcomes import Sensitivity
    from fixel.workflows.sensitivity.report import Finding, RankedPushes, Subject

BASE: Final = 128  # samples of the indices


def sensitivity(
    scene: Scene | SceneWithMethod | str | PathLike[str] | Experiment,
    start: StartError,
    model: Mapping[str, float] | None = None,
    *,
    samples: Annotated[int, Door(least=50, most=1_000_000)] = 1000,
    vary: Annotated[Mapping[str, tuple[float, float]] | None, Door(metavar="NAME=LOW:HIGH")] = None,
    indices: bool = False,
    base: int = BASE,
    motion: AbstractMotionModel | str | None = None,
    stepper: AbstractStepper | None = None,
    seed: Seed = 0,
    threads: Threads = None,
    progress: ProgressOption = None,
) -> Sensitivity:
    """Compute how errors of the start pose grow in a push.

    Parameters
    ----------
    scene : Scene, SceneFile, path or Experiment
        Push of one free body by at most one pusher. A scene file's motion model and step apply.
    start : StartError
        Distribution of the start pose about that of the scene.
    model : mapping of str to float or Calibration, optional
        Parameters [SI]; by default the scene's own values.
    samples : int
        Number of perturbed starts, at least 50 and at most one million.
    vary : mapping of str to (float, float), optional
        Bounds of further uncertain parameters for the indices [SI]; by default the intervals of a
        calibration.
    indices : bool
        Whether to compute Sobol indices: the shares of the spread of the end that come from each
        uncertain input. This takes ``base (n_input + 2)`` more simulations and the package SALib.
    base : int
        Base samples of the indices, a power of two. Another number than the default requests the
        indices.
    motion : AbstractMotionModel or str, optional
        Motion model; by default that of the calibration, else `Dynamic()`.
    stepper : AbstractStepper, optional
        Stepper; `Adaptive()` by default.
    seed : int
        Seed of the random numbers.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    Sensitivity
        Growth of the start error, separate outcomes, and a verdict on both: `.flag`.

    Raises
    ------
    InvalidInput
        The scene has several free bodies or pushers, hardly any start has an outcome, or a
        parameter is not known.

    References
    ----------
    :cite:t:`rpi2011`; :cite:t:`saltelli2010`.

    Examples
    --------
    >>> from fixel import StartError
    >>> from fixel.testing.scenes import micro_push
    >>> from fixel.units import deg, um
    >>> start = StartError(x=5*um, y=5*um, theta=0.5*deg, kind="uniform")
    >>> found = sensitivity(micro_push(1), start, samples=60)
    >>> found.flag
    'insensitive'
    """
    from fixel.model.fields import instance
    from fixel.progress import show_progress
    from fixel.trust import permit
    from fixel.uncertainty.error_terms import StartError
    from fixel.uncertainty.indices import indices_of
    from fixel.uncertainty.outcomes import sensitivity_of
    from fixel.uncertainty.prediction import push_of
    from fixel.uncertainty.start_ensemble import simulate_starts

    instance(start, StartError, "start", "a StartError")
    instance(vary, Mapping | None, "vary", "bounds by name of parameter")
    permit(motion)
    push = push_of(scene, model, motion)
    ranges = dict(push.intervals if vary is None else vary)
    with show_progress(progress, "simulating starts") as report:
        method: dict[str, Any] = {
            "values": push.values,
            "motion": push.motion,
            "stepper": stepper or push.stepper,
            "seed": seed,
            "threads": threads,
            "progress": report,
        }
        ensemble = simulate_starts(push.scene, start, samples, **method)
        found = sensitivity_of(ensemble)
        if not (indices or base != BASE):
            return found
        report.stage = "computing indices"
        return replace(found, indices=indices_of(push.scene, start, ranges, base, **method))


@dataclass(frozen=True, slots=True, kw_only=True)
class StartSizes:
    """Start error with the same size along x and y, as a request states it.

    Attributes
    ----------
    place : float
        Size of the start error along x and y, with --uniform or --normal; 0.3 by default.
    angle : float
        Size of the start error of the angle, with --uniform or --normal; 0.5 by default.
    uniform : bool, optional
        Sizes are half-widths (uniform) or standard deviations (normal). A size needs one of them;
        without any size the default is uniform.
    """

    place: Annotated[float, Door(flag="--start-error-mm", unit="mm", least=0.0)] = 0.3 * mm
    angle: Annotated[float, Door(flag="--start-error-deg", unit="deg", least=0.0)] = 0.5 * deg
    uniform: Annotated[bool | None, Door(flag="--uniform/--normal")] = None

    def build(self) -> StartError:
        """Return the start error for Python."""
        from fixel.uncertainty.error_terms import StartError

        if self.uniform is None:
            kinds = "--uniform (they are half-widths) or --normal (standard deviations)"
            raise InvalidInput("start_error", found="sizes alone", expected=kinds)
        kind: Any = "uniform" if self.uniform else "normal"
        return StartError(x=self.place, y=self.place, theta=self.angle, kind=kind)


StartOption = Annotated["StartError | None", Door(plain=StartSizes | None)]


def sensitivity_of_pushes(
    project: Project | None,
    experiments: Annotated[tuple[str, ...], Door(metavar="[EXPERIMENT|SCENE.yaml]...")] = (),
    *,
    calibration: Annotated[
        int | None, Door(metavar="ID", usual="the newest; nominal values if there is none")
    ] = None,
    engine: Annotated[str | None, Door(metavar="NAME", program=True)] = None,
    values: Values = None,
    start_error: StartOption = None,
    preset: str | None = None,
    progress: ProgressOption = None,
    **options: Any,
) -> RankedPushes:
    """Report how errors of the start grow during pushes.

    Parameters
    ----------
    project : Project, optional
        Not needed for scene files without a calibration.
    experiments : tuple of str
        Experiments (id, name or DATASET/NAME) or scene files; by default all experiments with a
        scene.
    calibration : int, optional
        Stored calibration whose parameters are used.
    engine : str, optional
        Use the newest calibration by this engine, such as mujoco, which also simulates scene files.
    values : mapping of str to float, optional
        Value of a parameter; may be repeated.
    start_error : StartError, optional
        Distribution of the start pose about that of the scene.
    preset : str, optional
        Preset start error, without sizes: asme (+-5 um, +-0.5 deg) or rpi-camera (noise of the
        camera at RPI).
    **options
        Options of `sensitivity`.
    """
    asked = SENSITIVITY.asked({**locals(), "start_error": None})  # which is an object here
    from fixel.simulation.simulate import get_ready
    from fixel.uncertainty.error_terms import preset as named
    from fixel.workflows.sensitivity.report import RankedPushes, by_flag, selected

    if preset is not None and start_error is not None:
        raise InvalidInput("preset", found="a preset and a start error", expected="one of them")
    usual = replace(StartSizes(), uniform=True)
    error = named(preset) if preset is not None else start_error or usual.build()
    subjects, skipped, number = selected(project, asked)
    get_ready(subjects[0].scene)
    options["indices"] = bool(options.pop("vary", None)) or options.get("indices")
    found = _analysed(subjects, skipped, error, {**options, "progress": progress})
    return RankedPushes(sorted(found, key=by_flag), skipped, error, number)


def _analysed(
    subjects: list[Subject], skipped: dict[str, str], error: StartError, options: dict[str, Any]
) -> list[Finding]:
    """Analyse pushes; those without an outcome are skipped, unless there is only one push."""
    from fixel.workflows.sensitivity.report import Finding

    found = []
    for one in subjects:
        method: Any = {"vary": one.ranges, "motion": one.motion, "stepper": one.stepper}
        try:
            found.append(
                Finding(one, sensitivity(one.scene, error, one.values, **method, **options))
            )
        except InvalidInput as problem:
            if len(subjects) == 1:
                raise
            skipped[one.key] = str(problem)
    if not found:
        why = next(iter(skipped.values()))
        raise InvalidInput("experiments", found=f"no outcome ({why})", expected="at least one")
    return found


def in_project(request: Any) -> bool:
    """Return whether a request needs a project: for experiments or a calibration."""
    from fixel.workflows.sensitivity.report import is_scene_file

    things = request.experiments
    return bool(request.calibration) or not things or not all(map(is_scene_file, things))


SENSITIVITY: Final = Capability(
    name="sensitivity",
    function=sensitivity_of_pushes,
    of=sensitivity,
    leave_out=("scene", "start", "model", "motion", "stepper"),
    in_project=in_project,
    on_table=True,
)
