"""Tour from a film to calibrated parameters, with the truth known at every step."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.project import SETTINGS, Project
from fixel.drawing.tracking import TrackedRun, side_by_side
from fixel.errors import InvalidInput
from fixel.formats.recording import is_recording, open_recording
from fixel.formats.scene_file import load_scene
from fixel.model import Experiment, PathDrive, Scene, Trajectory, placed
from fixel.model.records import Estimate
from fixel.model.selection import ExperimentQuery
from fixel.sampling.published import thesis_plan
from fixel.table import Column, Table
from fixel.testbed.emulators import bench as mega
from fixel.testbed.emulators.bench import emulated_bench
from fixel.testbed.frame_source import CameraPicture
from fixel.testbed.recorder import RecordingStatus, RecordingSummary
from fixel.testbed.simulated import SimulatedTestbed
from fixel.typing import Notify, ProgressCallback
from fixel.workflows.acquisition import RecordPlan, film_experiments
from fixel.workflows.acquisition.film import ARRAYS
from fixel.workflows.acquisition.record import record
from fixel.workflows.acquisition.track import TrackAnswer, track_film
from fixel.workflows.analysis import Analysis, Picture, store_analysis
from fixel.workflows.capabilities import call
from fixel.workflows.demo.laboratory_demo import own_folder, true_mean
from fixel.workflows.report.write import Report

# From the plan of the thesis: straight on, off the middle, turned; pushes from several sides
# inform friction better than a single one.
PUSHES: Final = (0, 12, 18)
SEED: Final = 1
LEAD: Final = 0.5  # [s] at rest before the drive starts
SIMULATED, TRACKED, TRUE = "testbed", "tracked", "true-poses"  # datasets
MARK: Final = "tour.json"  # in the folder: the request, so that the same tour can continue
RUNS: Final = "runs.json"  # in the folder: drive positions at the end of each recording
ATTEMPTS: Final = 2  # recordings of a run, until its object is tracked from its start


class CameraTour(NamedTuple):
    """Result of the camera tour."""

    project: Path
    runs: tuple[TrackedRun, ...]
    # Estimate of each parameter from tracked poses, and from true ones.
    estimates: tuple[tuple[Estimate, Estimate], ...]
    # True value of each parameter; None if the laboratory has no such property.
    truths: tuple[float | None, ...]
    frames: int
    lost: int  # frames that the recorder lost because it was too slow
    drive: dict[str, float]  # position of the drive at the end of each run, as it reported it [m]
    report: Report
    # Films with the measured outlines, and sheets with a few of their frames.
    overlays: tuple[Path, ...]

    @property
    def errors(self) -> tuple[float, float]:
        """Errors of position [m] and angle [rad] over all frames of all runs."""
        return errors_of(self.runs)


def run_camera_tour(
    folder: Path,
    *,
    pushes: tuple[int, ...] = PUSHES,
    notify: Notify | None = None,
    progress: ProgressCallback | None = None,
) -> CameraTour:
    """Film simulated pushes, record the films with a camera, track, calibrate and compare.

    A tour that was interrupted, or whose recordings could not be tracked, continues in its folder.

    The camera is a network camera that plays the film; the fixels are read from the real firmware
    in an emulator, where that can be built, through a serial port; the drive is an emulated GRBL
    controller. Pushes are indices in the plan of the thesis. `notify` is called with a sentence
    before each part of the tour. Raise `InvalidInput` if the folder contains something else, or a
    run could not be tracked from its start.
    """
    notify = notify or (lambda _: None)
    folder = own_folder(folder, notify)
    project = _begun(folder, {"pushes": list(pushes), "frames": None})  # the latter of old tours
    films = _filmed(project, folder, pushes, notify, progress)
    firmware = _firmware(folder, notify)
    runs, lost, total = [], 0, 0
    for made in films:
        name = made.name
        answer = _tracked(folder, made, firmware, notify)
        recording = open_recording(folder / "recordings" / name)
        lost += 0 if recording.end is None else recording.end.lost
        total += recording.n_frames
        twin, run = true_twin(answer.experiment, made)
        with project.store() as store:
            video = store.add_video(answer.film.video)
            store.add_experiment(replace(answer.experiment, video=video))
            store.add_experiment(twin)
        runs.append(run)
    notify("calibrating friction and support to the tracked poses, and to the true ones")
    own: dict[str, Any] = {"optimiser": "least-squares", "flagged": True, "progress": False}
    numbers = [
        call(project, "calibrate", dataset=dataset, name=dataset, **own).ids[-1]
        for dataset in (TRUE, TRACKED)
    ]
    with project.store() as store:
        true, tracked = (store.calibration(number).estimates for number in numbers)
    estimates, truths = tuple(zip(tracked, true, strict=True)), _truths(project, true)
    _keep(project, tuple(runs), estimates, truths, numbers[1])
    notify("writing the report")
    at = shlex.quote(str(project.folder))
    report = project.report(
        folder / "report", calibration=numbers[1], command=f"fixel report --project {at}"
    )
    return CameraTour(
        project=project.folder,
        runs=tuple(runs),
        estimates=estimates,
        truths=truths,
        frames=total,
        lost=lost,
        drive={name: at for name, at in _noted(folder).items() if at is not None},
        report=report,
        overlays=tuple(sorted(folder.glob("*-overlay.*"))),
    )


def _truths(project: Project, estimates: Sequence[Estimate]) -> tuple[float | None, ...]:
    """Return the true values of estimated parameters; None for properties that do not exist."""
    with project.store() as store:
        own = store.experiments(ExperimentQuery(dataset=SIMULATED, include_faulty=True))
        simulated = [store.experiment(row.id) for row in own.rows]
    return tuple(true_mean(one.label, simulated) for one in estimates)


def _begun(folder: Path, asked: dict[str, object]) -> Project:
    """Create the folder of a tour, or open that of an interrupted one with the same request."""
    mark, lab = folder / MARK, folder / "lab"
    if not folder.exists():
        folder.mkdir(parents=True)
        mark.write_text(json.dumps(asked), encoding="utf-8")
    elif not mark.is_file():
        raise InvalidInput(str(folder), found="an existing file or folder", expected="a new folder")
    elif json.loads(mark.read_text(encoding="utf-8")) != asked:
        raise InvalidInput(str(folder), found="a tour of other pushes", expected="a new folder")
    return Project(lab) if (lab / SETTINGS).is_file() else Project.create(lab)


def _tracked(folder: Path, made: Path, firmware: Path | None, notify: Notify) -> TrackAnswer:
    """Record a film if that has not been done, and track it; raise where the object is lost."""
    name, out = made.name, folder / "recordings" / made.name
    why_not = ""
    for _ in range(ATTEMPTS):
        if not (is_recording(out) and open_recording(out).complete):
            shutil.rmtree(out, ignore_errors=True)
            again = f" again: {why_not}" if why_not else ""
            notify(
                f"recording {name} from a network camera, with tactile board and drive on serial "
                f"ports{again}"
            )
            scene = load_scene(made / "scene.yaml").scene
            _, position = record_film(made, out, scene, LEAD, firmware)
            noted = _noted(folder) | {name: position}
            (folder / RUNS).write_text(json.dumps(noted), encoding="utf-8")
        notify(f"tracking {name}")
        answer = track_film(
            out,
            dataset=TRACKED,
            name=name,
            overlay=folder / f"{name}-overlay.mp4",
            sheet=folder / f"{name}-overlay.png",
        )
        if answer.experiment.scene is not None:
            return answer
        why_not = "; ".join(flag.detail for flag in answer.experiment.flags if flag.detail)
        shutil.rmtree(out)
    raise InvalidInput(
        f"recording {name}",
        found=f"no scene ({why_not})" if why_not else "no scene",
        expected="an object that is tracked from its start",
        hint="the computer may be too busy to record; repeat the command to continue with this run",
    )


def record_film(
    film: Path, out: Path, scene: Scene, lead: float, firmware: Path | None
) -> tuple[RecordingSummary, float | None]:
    """Record a film as if it took place on a bench; return also the position of the drive at its
    end.

    The drive gets its motion from the planned scene, after a rest of `lead` [s]. For the firmware,
    see `emulated_bench`.
    """
    with emulated_bench(film, firmware) as bench:
        begun = False

        def watch(_: CameraPicture, status: RecordingStatus) -> None:
            nonlocal begun
            if not begun:
                begun = True
                bench.begin(status, scene, lead)

        plan = RecordPlan(
            camera=bench.camera,
            folder=out,
            tactile=bench.tactile,
            rig=str(film / "rig.yaml"),
            scene=film / "scene.yaml",
        )
        recorded = record(plan, watch=watch)
        return recorded, bench.end()


def _noted(folder: Path) -> dict[str, float | None]:
    """Load the drive's position at the end of each run [m], by the run's name."""
    path = folder / RUNS
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def true_twin(tracked: Experiment, film: Path) -> tuple[Experiment, TrackedRun]:
    """Return the experiment with true poses at the frames, and a comparison of both.

    The folder of the tracked film has the ground truth.
    """
    scene = tracked.scene
    if scene is None:
        raise InvalidInput(tracked.key, found="no scene", expected="a run with a scene")
    body, pusher = scene.bodies[0], scene.pushers[0]
    with np.load(film / "truth.npz") as truth:
        time = truth["time_s"] - truth["time_s"][0]
        pose, path = truth[f"pose_{body.name}"], truth[f"pose_{pusher.name}"]
    planned = load_scene(film / "scene.yaml").scene
    drive = PathDrive(waypoints=np.column_stack((time, path)), force_limit=pusher.drive.force_limit)
    twin = replace(
        tracked,
        dataset=TRUE,
        video="",
        trajectory=Trajectory(time=time, pose=pose),
        pusher=Trajectory(time=time, pose=path),
        scene=replace(
            scene,
            bodies=(replace(body, pose=pose[0]),),
            pushers=(replace(pusher, drive=drive),),
            fixels=planned.fixels,
        ),
        flags=(),
    )
    # A lost or rejected frame is left out; the others may be a little late or early.
    at = tracked.trajectory.time
    nearest = np.abs(time[:, None] - at).argmin(axis=0)
    run = TrackedRun(
        name=tracked.name,
        outline=body.shape.outline,
        fixels=[placed(fixel.shape.outline, fixel.pose) for fixel in planned.fixels],
        time=at,
        true=pose[nearest],
        tracked=tracked.trajectory.pose,
    )
    return twin, run


def errors_of(runs: tuple[TrackedRun, ...]) -> tuple[float, float]:
    """Compute root mean square errors of position [m] and angle [rad] over all frames."""
    position = np.concatenate([run.position_error for run in runs])
    angle = np.concatenate([run.angle_error for run in runs])
    return math.sqrt(np.mean(position**2)), math.sqrt(np.mean(angle**2))


def within_interval(estimate: Estimate, value: float) -> bool:
    """Whether a value lies in the interval of an estimate; an interval may be open."""
    low = -math.inf if estimate.low is None else estimate.low
    high = math.inf if estimate.high is None else estimate.high
    return low <= value <= high


def _filmed(
    project: Project,
    folder: Path,
    pushes: tuple[int, ...],
    notify: Notify,
    progress: ProgressCallback | None,
) -> list[Path]:
    planned = [thesis_plan().experiments[k] for k in pushes]
    films = folder / "films"
    missing = [one.name for one in planned if not _is_film(films / one.name)]
    if not missing:
        return [films / one.name for one in planned]
    notify(f"simulating {len(pushes)} pushes")
    with project.store() as store:
        for experiment in SimulatedTestbed(seed=SEED, dataset=SIMULATED).run(planned):
            store.add_experiment(experiment)
    notify(f"filming {len(pushes)} pushes of a simulated laboratory with a virtual camera")
    films.mkdir(exist_ok=True)
    for name in missing:
        shutil.rmtree(films / name, ignore_errors=True)
        own: dict[str, Any] = {"out": films / name, "seed": SEED, "lead": LEAD}
        film_experiments([name], **own, project=project.folder, progress=progress)
    return [films / one.name for one in planned]


def _is_film(folder: Path) -> bool:
    """Whether a folder has a complete film with its ground truth."""
    return is_recording(folder) and open_recording(folder).complete and (folder / ARRAYS).is_file()


def _firmware(folder: Path, notify: Notify) -> Path | None:
    """Build the firmware of the fixels and its emulator; None if that is not possible."""
    missing = mega.why_not()
    if missing:
        notify(f"contacts are read from the film, not from an emulated board: {missing}")
        return None
    notify("building the firmware of the tactile board and its emulator")
    return mega.built(folder / "firmware")


def _keep(
    project: Project,
    runs: tuple[TrackedRun, ...],
    estimates: tuple[tuple[Estimate, Estimate], ...],
    truths: tuple[float | None, ...],
    number: int,
) -> None:
    position, angle = errors_of(runs)
    within = sum(within_interval(tracked, true.value) for tracked, true in estimates)
    pairs = zip(estimates, truths, strict=True)
    known = [(pair, truth) for pair, truth in pairs if truth is not None]
    right = [sum(within_interval(pair[k], truth) for pair, truth in known) for k in (0, 1)]
    with project.store() as store:
        listing = store.experiments(ExperimentQuery(dataset=TRACKED, include_faulty=True))
    analysis = Analysis(
        kind="tracking",
        title="Tracked against true poses",
        question={"runs": [run.name for run in runs], "seed": SEED},
        headline=(
            f"Tracked poses are {1e3 * position:.3f} mm and"
            f" {math.degrees(angle):.3f} deg from the true ones (root mean square over"
            f" {sum(len(run.time) for run in runs)} frames).",
            f"For {within} of {len(estimates)} parameters, the value estimated from true poses is "
            "within the interval estimated from the film.",
            f"The laboratory is simulated: of {len(known)} parameters with a known true value, "
            f"{right[0]} intervals from the film and {right[1]} from true poses contain it.",
        ),
        tables=(_run_table(runs), estimate_table(estimates, truths)),
        methods=(
            "The motion of a simulated laboratory was rendered for its camera, recorded and "
            "tracked without use of the true poses.",
        ),
        numbers={
            "position_rms_m": position,
            "angle_rms_rad": angle,
            "agreeing": within,
            "parameters": len(estimates),
        },
        calibrations=(number,),
        experiments=tuple(summary.id for summary in listing.rows),
        command="fixel demo --camera",
        seed=SEED,
    )
    picture = Picture(
        name="side_by_side",
        chart=side_by_side(runs),
        banner="SIMULATED: these are not pictures of a real camera",
        caption="True and tracked trajectories of the object, and their difference.",
    )
    store_analysis(project, analysis, (picture,))


def _run_table(runs: tuple[TrackedRun, ...]) -> Table:
    rows = []
    for run in runs:
        far, turned = run.position_error.max(), np.abs(run.angle_error).max()
        (position, angle), own = errors_of((run,)), (run.name, len(run.time))
        rows.append((*own, 1e3 * position, 1e3 * far, math.degrees(angle), math.degrees(turned)))
    names = [Column(what, unit, ".3f") for unit in ("mm", "deg") for what in ("RMS", "largest")]
    head: tuple[Column | str, ...] = ("run", "frames", *names)
    return Table(head, rows, title="Difference of tracked and true poses")


def estimate_table(
    estimates: tuple[tuple[Estimate, Estimate], ...], truths: tuple[float | None, ...]
) -> Table:
    """Table of the values from the film and from true poses, compared with the truth."""
    rows = tuple(
        (
            tracked.label,
            "none" if truth is None else tracked.text(truth),
            written_estimate(tracked, truth),
            written_estimate(true, truth),
            "yes" if within_interval(tracked, true.value) else "NO",
        )
        for (tracked, true), truth in zip(estimates, truths, strict=True)
    )
    head = ("parameter", "truth", "from the film", "from true poses", "agree")
    return Table(head, rows, title="Parameters with intervals and verdicts", left=5)


def written_estimate(estimate: Estimate, truth: float | None = None) -> str:
    """Format value, interval and verdict: `0.41 (0.38 to 0.44), identified: right`.

    An estimate is right if its interval contains the true value.
    """
    text = f"{estimate.text(estimate.value)} ({estimate.interval_text}), {estimate.verdict}"
    if truth is None:
        return text
    return f"{text}: {'right' if within_interval(estimate, truth) else 'WRONG'}"
