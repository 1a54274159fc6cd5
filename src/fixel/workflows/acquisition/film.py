"""Render simulated experiments as recordings, together with their ground truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.database.project import Project
from fixel.errors import InvalidInput
from fixel.formats.plan_file import load_plan
from fixel.formats.recording import RIG_FILE, SCENE_FILE, RecordingHeader, RecordingWriter
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import SceneFile, load_scene, save_scene
from fixel.formats.video_file import VideoWriter
from fixel.io.atomic import write_whole, written_whole
from fixel.io.document import read_document
from fixel.model import Body, Experiment, PlannedExperiment, Pusher, Scene, Trajectory, pose_error
from fixel.model.probability import stream
from fixel.simulation import Simulation, simulate
from fixel.simulation.result import finite_track
from fixel.simulation.simulate import get_ready
from fixel.testbed.imperfections import felt, touching
from fixel.testbed.simulated import TRUTH, SimulatedTestbed
from fixel.typing import BoolArray, FloatArray, ProgressCallback
from fixel.vision import render
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render.bench import HAND
from fixel.vision.render.film import Occlusion, poses_at
from fixel.vision.render.looks import light

Write = Callable[[Frame, int | None, float], None]

# A film has no date of its own, and the same seed must give the same bits.
STARTED: Final = "2000-01-01T00:00:00.000+00:00"

# Files stored in the folder of a recording besides its rig and scene.
ARRAYS: Final = "truth.npz"
ABOUT: Final = "truth.json"


class FilmResult(NamedTuple):
    """Result of rendering one film."""

    name: str
    folder: Path  # folder of the recording, its rig, scene and truth
    frames: int
    seconds: float  # time of the last frame [s]
    status: str  # status of the simulation
    video: Path | None = None  # copy of the film as one video file
    # Moving bodies and pushers without marks in the rig, which cannot be tracked.
    unmarked: tuple[str, ...] = ()


def filmed(request: Any, project: Path, progress: ProgressCallback | None) -> list[FilmResult]:
    """Render films as a request of `fixel testbed film` states.

    Several films are in folders below `out`. A single film may also become a video file, which a
    camera source can play.
    """
    from fixel.testing.scenes import sliding_block

    out, video = request.out, request.video
    rig = rig_of(request.rig)
    looks = render.changed(_looks(request.looks, rig), request.changes)
    if out.exists():
        raise InvalidInput(str(out), found="an existing folder", expected="a new folder")
    count, items = film_scenes(request.sources, project, seed=request.seed, limit=request.limit)
    if video is not None and count > 1:
        raise InvalidInput("video", found=f"{count} films", expected="one film, for one video file")
    if count > 1:
        out.mkdir(parents=True)
    get_ready(sliding_block())  # compiles the simulation, which the first scene needs
    made = []
    for subject in items:
        folder = out / subject.name if count > 1 else out
        made.append(_render(subject, folder, rig, looks, request, progress))
    return made


def _looks(name: str, rig: Rig) -> render.CameraEffects:
    small = rig.camera.metres_per_pixel() < render.MICROSCOPE
    if not name:
        return render.looks_named("microscope" if small else "thesis")
    looks = render.looks_named(name)
    if (looks.lighting == "through") != small:
        expected = "looks microscope or microscope-clean for a microscope, others for a bench"
        raise InvalidInput("looks", found=f"{name!r} with the rig {rig.name}", expected=expected)
    return looks


def _render(
    subject: FilmScene,
    folder: Path,
    rig: Rig,
    looks: render.CameraEffects,
    request: Any,
    progress: ProgressCallback | None,
) -> FilmResult:
    lead, video = request.lead, request.video
    # Each film has its own noise; otherwise films of one seed would have the same errors.
    seed = int(stream(request.seed, "film", subject.name).integers(2**31))
    duration = lead + float(subject.simulation.time[-1]) + request.rest
    times = render.frame_times(duration, request.rate, looks, seed)[: request.frames]
    tracks = tracks_of(subject, lead)
    truth = truth_of(subject, tracks, rig, looks, times, seed, lead)
    frames = render.film_scene(subject.scene, tracks, rig, looks, times, seed)
    header = RecordingHeader(
        size=rig.camera.lens.image_size,
        codec="exact" if request.exact else "near",
        rig=rig.name,
        source=f"fixel testbed film of {subject.name}",
        simulated_by=f"fixel testbed film of {subject.name}, seed {request.seed}",
        started=STARTED,
        rate=request.rate,
        about={"seed": request.seed},
    )
    folder.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        writers: list[Write] = [stack.enter_context(RecordingWriter(folder, header)).write]
        if video is not None:
            note = f"SIMULATED by {header.simulated_by}"
            copy = stack.enter_context(VideoWriter(video, header.size, rate=header.rate, note=note))
            writers.append(lambda frame, *_: copy.write(frame))
        # Before the frames: an interrupted film is then still usable.
        save_rig(rig, folder / RIG_FILE)
        save_scene(subject.planned, folder / SCENE_FILE)
        write_truth(subject, truth, looks, request.seed, lead, folder)
        for k, frame in enumerate(frames):
            reading = int(truth["reading"][k])
            for write in writers:
                write(frame, None if reading < 0 else reading, frame.time)
            if progress is not None:
                progress(k + 1, len(times))
    things: list[Body | Pusher] = [*subject.scene.bodies, *subject.scene.pushers]
    marked = [name for name, part in rig.parts.items() if part.marks]
    unmarked = tuple(own.name for own in things if own.name not in marked)
    return FilmResult(
        name=subject.name,
        folder=folder,
        frames=len(times),
        seconds=float(times[-1]),
        status=subject.simulation.status,
        video=video,
        unmarked=unmarked if looks.lighting == "above" else (),
    )


def tracks_of(subject: FilmScene, lead: float) -> dict[str, Trajectory]:
    """Return the true trajectories on the clock of a film that begins with a rest [s]."""
    simulation = subject.simulation
    return {name: finite_track(simulation, name, lead) for name in simulation.pose}


def truth_of(
    subject: FilmScene,
    tracks: Mapping[str, Trajectory],
    rig: Rig,
    looks: render.CameraEffects,
    times: FloatArray,
    seed: int,
    lead: float,
) -> dict[str, NDArray[Any]]:
    """Compute the ground truth of a film at its frame times (n,) [s], as `truth.npz` has it."""
    occlusion = Occlusion(subject.scene, rig, looks, times, seed)
    name = subject.scene.bodies[0].name
    covered = []
    for time in times.tolist():
        poses = poses_at(tracks, time, occlusion, subject.scene)
        covered.append(occlusion.share(poses.get(HAND), poses[name]))
    # Contacts at times of the simulation; those of the first sample before its start.
    own = subject.simulation.time
    sample = np.clip(np.searchsorted(own, times - lead, side="right") - 1, 0, len(own) - 1)
    touches = np.asarray(touching(subject.simulation)[sample])
    return {
        "time_s": times,
        # (n, n_fixel) Whether the object touches each fixel of the scene.
        "touches": touches,
        # (n,) Tactile byte as reported, with false and missed contacts; -1 without fixels.
        "reading": _readings(subject, rig, times, touches, seed),
        "light": light(looks, times, seed),  # (n, 3) factors of blue, green and red [-]
        "covered": np.array(covered),  # (n,) share of the object's upper face under the hand
        # (n, 3) Poses of bodies and pushers in the middle of the exposure [m, m, rad].
        **{f"pose_{name}": track.at(times) for name, track in tracks.items()},
    }


def write_truth(
    subject: FilmScene,
    arrays: Mapping[str, Any],
    looks: render.CameraEffects,
    seed: int,
    lead: float,
    folder: Path,
) -> None:
    """Write `truth.npz` (frame by frame) and `truth.json`; trackers must not read them."""
    with written_whole(folder / ARRAYS) as unfinished:
        np.savez_compressed(unfinished, **arrays)
    simulation = subject.simulation
    content = {
        "name": subject.name,
        "seed": seed,
        "testbed_seed": subject.testbed.seed,
        "looks": asdict(looks),
        "status": simulation.status,
        "motion_s": [lead, lead + float(simulation.time[-1])],
        "bodies": [body.name for body in subject.scene.bodies],
        "pushers": [pusher.name for pusher in subject.scene.pushers],
        "fixels": [fixel.name for fixel in subject.scene.fixels],
        "conditions": dict(subject.truth),
    }
    write_whole(folder / ABOUT, json.dumps(content, indent=1, allow_nan=False))


def _readings(
    subject: FilmScene, rig: Rig, times: FloatArray, touches: BoolArray, seed: int
) -> NDArray[np.int64]:
    """Tactile bytes (n,) as reported: one bit per coil, in the rig's order."""
    names = [fixel.name for fixel in subject.scene.fixels]
    if not names:
        return np.full(len(times), -1, np.int64)
    rng = stream(seed, "film", "tactile", subject.name)
    wrong = subject.testbed.false_contact, subject.testbed.missed_contact
    reported = felt(touches, *wrong, rng).astype(np.int64)
    total = np.zeros(len(times), np.int64)
    for bit, name in enumerate(rig.tactile):
        if name in names:
            total |= reported[:, names.index(name)] << bit
    return total


SAMPLE: Final = 1.0 / 240.0  # [s] between samples of the true motion

# Largest distance between the ends of a repeated and of the stored motion; the sampling of a
# rollout changes the steps of its solver, and its end by some micrometres.
SAME_END: Final = 2e-4  # [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmScene:
    """Scene to film, with its true motion."""

    name: str
    planned: SceneFile  # scene as the experimenter believes it to be
    simulation: Simulation  # true motion; its scene has the true shapes and frictions
    testbed: SimulatedTestbed  # testbed whose camera and fixels report the motion
    # Known true conditions, under names that end with their unit.
    truth: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> Scene:
        """Scene with the true shapes and frictions."""
        return self.simulation.scene


def film_scenes(
    sources: Sequence[str], project: Path, *, seed: int = 1, limit: int | None = None
) -> tuple[int, Iterator[FilmScene]]:
    """Return the number of scenes to film and an iterator over them.

    Arguments are those of `film_experiments`. The project is opened only if a source is an
    experiment, which must be one of a simulated testbed; the seed is that of the testbed that
    performs plans.
    """
    if not sources:
        expected = "a scene file, a plan file, or experiments of a project"
        hint = "fixel testbed film scene.yaml, or: fixel testbed film EXPERIMENT --project DIR"
        raise InvalidInput("film", found="nothing to film", expected=expected, hint=hint)
    makers = [make for source in sources for make in _makers(source, project, seed, limit)]
    return len(makers), (make() for make in makers)


def _makers(
    source: str, project: Path, seed: int, limit: int | None
) -> list[Callable[[], FilmScene]]:
    """One function for each scene of a source, which simulates it."""
    path = Path(source)
    if path.suffix.lower() not in (".yaml", ".yml", ".json"):
        with Project(project).store() as store:
            experiment = store.experiment(store.find(source))
        _check_simulated(experiment)
        return [partial(_again, experiment)]
    if "bodies" in read_document(path, "scene file"):
        return [partial(_as_written, path.stem, load_scene(path), seed)]
    bench = SimulatedTestbed(seed=seed)
    return [partial(_performed, planned, bench) for planned in load_plan(path).experiments[:limit]]


def _as_written(name: str, scene_file: SceneFile, seed: int) -> FilmScene:
    """Simulate a scene file exactly as it is written."""
    simulation = simulate(scene_file, output_interval=SAMPLE)
    bench = SimulatedTestbed.ideal(seed)
    return FilmScene(name=name, planned=scene_file, simulation=simulation, testbed=bench)


def _performed(planned: PlannedExperiment, bench: SimulatedTestbed) -> FilmScene:
    """Simulate a planned experiment on the simulated testbed."""
    simulation = simulate(bench.true_scene(planned), output_interval=SAMPLE)
    believed = SceneFile(scene=planned.scene)
    return FilmScene(name=planned.name, planned=believed, simulation=simulation, testbed=bench)


def _again(experiment: Experiment) -> FilmScene:
    """Repeat an experiment of the simulated testbed to obtain its true motion."""
    scene, conditions = experiment.scene, experiment.conditions
    assert scene is not None
    planned = PlannedExperiment(
        name=experiment.name,
        scene=scene,
        conditions={k: v for k, v in conditions.items() if not k.startswith(TRUTH)},
    )
    seed = experiment.provenance.seed
    bench = SimulatedTestbed(seed=1 if seed is None else seed, dataset=experiment.dataset)
    subject = _performed(planned, bench)
    end = subject.simulation.pose[experiment.object_name][-1]
    remembered = np.array([conditions[f"{TRUTH}final_{k}"] for k in ("x_m", "y_m", "angle_rad")])
    apart, _ = pose_error(end, remembered)
    if apart > SAME_END:
        raise InvalidInput(
            f"experiment {experiment.key}",
            found=f"a motion that ends {apart * 1e3:.2f} mm from the stored end",
            expected="the stored motion",
            hint="it was performed with other settings than those of `fixel testbed run`",
        )
    truth = {k: v for k, v in conditions.items() if k.startswith(TRUTH)}
    return replace(subject, truth=truth)


def _check_simulated(experiment: Experiment) -> None:
    """Raise for an experiment that the simulated testbed did not perform."""
    known = experiment.scene is not None and f"{TRUTH}final_x_m" in experiment.conditions
    if experiment.real or not known:
        raise InvalidInput(
            f"experiment {experiment.key}",
            found="a real experiment" if experiment.real else "one whose true motion is unknown",
            expected="one of the simulated testbed",
            hint="perform some: fixel testbed run",
        )
