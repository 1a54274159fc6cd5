"""Render simulated experiments as recordings, together with their ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from fixel.errors import InvalidInput
from fixel.formats.recording import RecordingHeader, RecordingWriter
from fixel.formats.rig_file import rig_of, save_rig
from fixel.formats.scene_file import save_scene
from fixel.formats.video_file import VideoWriter
from fixel.model.chance import stream
from fixel.typing import Notify, Progress
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render import MICROSCOPE, Looks, changed, film_scene, frame_times, looks_named
from fixel.workflows.acquisition.film_shots import FilmScene, shots
from fixel.workflows.acquisition.film_truth import Truth, tracks_of, truth_of, write_truth
from fixel.workflows.compilation import get_ready

Write = Callable[[Frame, int | None, float], None]

LEAD: Final = 0.5  # [s] at rest before the motion
REST: Final = 0.5  # [s] at rest after the motion
RATE: Final = 30.0  # [Hz]

# A film has no date of its own, and the same seed must give the same bits.
STARTED: Final = "2000-01-01T00:00:00.000+00:00"

# Files stored in the folder of a recording.
RIG_FILE: Final = "rig.yaml"
SCENE_FILE: Final = "scene.yaml"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Shooting:
    """Settings of a film.

    Attributes
    ----------
    rig : str
        File of the rig, or name of an example.
    looks : str
        Appearance preset; empty for the one that suits the rig: `thesis` or `microscope`.
    changes : tuple of str
        Values of the looks to change, each as `NAME=VALUE`.
    seed : int
        Seed of all random numbers.
    codec : str
        `near` or `exact`, as for recordings.
    rate : float
        Frame rate [Hz].
    lead, rest : float
        Rest before and after the motion [s].
    frames : int, optional
        Maximum number of frames.
    """

    rig: str = "thesis-tags"
    looks: str = ""
    changes: tuple[str, ...] = ()
    seed: int = 1
    codec: str = "near"
    rate: float = RATE
    lead: float = LEAD
    rest: float = REST
    frames: int | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class FilmResult:
    """Result of rendering one film.

    Attributes
    ----------
    name : str
    folder : Path
        Folder of the recording, its rig, scene and truth.
    frames : int
    seconds : float
        Time of the last frame [s].
    status : str
        Status of the simulation.
    video : Path or None
        Copy of the film as one video file.
    unmarked : tuple of str
        Moving bodies and pushers without marks in the rig, which cannot be tracked.
    """

    name: str
    folder: Path
    frames: int
    seconds: float
    status: str
    video: Path | None = None
    unmarked: tuple[str, ...] = ()


def film(
    sources: list[str],
    out: Path,
    shooting: Shooting | None = None,
    *,
    project: Path = Path(),
    limit: int | None = None,
    video: Path | None = None,
    notify: Notify | None = None,
    progress: Progress | None = None,
) -> list[FilmResult]:
    """Render films of scenes, plans and experiments.

    Parameters
    ----------
    sources : list of str
        Scene files, plan files, and ids or names of experiments of the project.
    out : Path
        Folder to create: the recording, or a folder of recordings for several films.
    shooting : Shooting, optional
    project : Path
    limit : int, optional
        Maximum number of experiments per plan.
    video : Path, optional
        Video file to write too, which a camera source can play; only for a single film.
    notify : callable, optional
        Called with a sentence before long operations.
    progress : callable, optional
        Called as `progress(done, total)` after every frame of a film.

    Raises
    ------
    InvalidInput
        Nothing to film, or an invalid rig, looks or folder.
    """
    shooting = shooting or Shooting()
    rig = rig_of(shooting.rig)
    looks = changed(_looks(shooting.looks, rig), shooting.changes)
    if out.exists():
        raise InvalidInput(
            str(out), found="a folder that is there", expected="a name for a new one"
        )
    count, items = shots(sources, project, seed=shooting.seed, limit=limit)
    if video is not None and count > 1:
        raise InvalidInput("video", found=f"{count} films", expected="one, for one video file")
    if count > 1:
        out.mkdir(parents=True)
    filmed = []
    for shot in _prepared(items, notify):
        folder = out / shot.name if count > 1 else out
        filmed.append(_shoot(shot, folder, rig, looks, shooting, video, progress))
    return filmed


def _looks(name: str, rig: Rig) -> Looks:
    small = rig.camera.metres_per_pixel() < MICROSCOPE
    if not name:
        return looks_named("microscope" if small else "thesis")
    looks = looks_named(name)
    if (looks.lighting == "through") != small:
        raise InvalidInput(
            "looks",
            found=f"{name!r} with the rig {rig.name}",
            expected="microscope or microscope-clean for a microscope, another for a bench",
        )
    return looks


def _prepared(items: Iterator[FilmScene], notify: Notify | None) -> Iterator[FilmScene]:
    """Prepare the compiled code of the simulation, then yield the scenes."""
    from fixel.testing.scenes import sliding_block

    get_ready(sliding_block(), notify)
    yield from items


def _shoot(
    shot: FilmScene,
    folder: Path,
    rig: Rig,
    looks: Looks,
    shooting: Shooting,
    video: Path | None,
    progress: Progress | None,
) -> FilmResult:
    # Each film has its own noise; otherwise films of one seed would have the same errors.
    seed = int(stream(shooting.seed, "film", shot.name).integers(2**31))
    duration = shooting.lead + float(shot.simulation.time[-1]) + shooting.rest
    times = frame_times(duration, shooting.rate, looks, seed)[: shooting.frames]
    truth = truth_of(shot, rig, looks, times, seed, shooting.lead)
    frames = film_scene(shot.scene, tracks_of(shot, shooting.lead), rig, looks, times, seed)
    header = RecordingHeader(
        size=rig.camera.lens.image_size,
        codec=shooting.codec,
        rig=rig.name,
        source=f"fixel testbed film of {shot.name}",
        simulated_by=f"fixel testbed film of {shot.name}, seed {shooting.seed}",
        started=STARTED,
        rate=shooting.rate,
        about={"seed": shooting.seed},
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
        save_scene(shot.planned, folder / SCENE_FILE)
        write_truth(shot, truth, looks, shooting.seed, shooting.lead, folder)
        _write_frames(frames, truth, writers, progress)
    return FilmResult(
        name=shot.name,
        folder=folder,
        frames=len(times),
        seconds=float(times[-1]),
        status=shot.simulation.status,
        video=video,
        unmarked=_unmarked(shot, rig) if looks.lighting == "above" else (),
    )


def _unmarked(shot: FilmScene, rig: Rig) -> tuple[str, ...]:
    """Names of moving bodies and pushers without marks in the rig."""
    moving = [body.name for body in shot.scene.bodies]
    moving += [pusher.name for pusher in shot.scene.pushers]
    return tuple(name for name in moving if name not in rig.parts or not rig.parts[name].marks)


def _write_frames(
    frames: Iterator[Frame], truth: Truth, writers: list[Write], progress: Progress | None
) -> None:
    total = len(truth.time)
    for k, frame in enumerate(frames):
        reading = int(truth.reading[k])
        for write in writers:
            write(frame, None if reading < 0 else reading, frame.time)
        if progress is not None:
            progress(k + 1, total)
