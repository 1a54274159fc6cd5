"""The rendered twin: recordings of simulated experiments, with the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from fixel.errors import InvalidInput
from fixel.exchange.atomic import written_whole
from fixel.exchange.recording import RecordingHeader, RecordingWriter
from fixel.exchange.rig_file import rig_of, save_rig
from fixel.exchange.scene_file import save_scene
from fixel.exchange.video_file import VideoWriter
from fixel.model import Trajectory
from fixel.model.chance import stream
from fixel.model.fields import BoolArray, FloatArray
from fixel.testbed.sensors import tactile_channel, touching
from fixel.vision.frame import Frame
from fixel.vision.marks import Rig
from fixel.vision.render import MICROSCOPE, Looks, film_scene, frame_times, looks_named
from fixel.vision.render.film import occlusion_of, poses_at
from fixel.vision.render.looks import light
from fixel.workflows.engine import Say, get_ready
from fixel.workflows.film_shots import Shot, shots

Progress = Callable[[int, int], None]

LEAD: Final = 0.5  # [s] at rest before the motion
REST: Final = 0.5  # [s] after it
RATE: Final = 30.0  # [Hz]

# A film has no date of its own, and the same seed must give the same bits.
STARTED: Final = "2000-01-01T00:00:00.000+00:00"

# Names of the files beside a recording.
RIG_FILE: Final = "rig.yaml"
SCENE_FILE: Final = "scene.yaml"
TRUTH_ARRAYS: Final = "truth.npz"
TRUTH: Final = "truth.json"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Shooting:
    """How to film.

    Attributes
    ----------
    rig : str
        A rig file, or the name of an example.
    looks : str
        A preset; empty for the one that suits the rig: `thesis` or `microscope`.
    seed : int
        Of everything random.
    codec : str
        `near` or `exact`, as for recordings.
    rate : float
        Frames a second [Hz].
    lead, rest : float
        At rest before and after the motion [s].
    frames : int, optional
        No more than so many.
    """

    rig: str = "thesis-tags"
    looks: str = ""
    seed: int = 1
    codec: str = "near"
    rate: float = RATE
    lead: float = LEAD
    rest: float = REST
    frames: int | None = None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Filmed:
    """One film.

    Attributes
    ----------
    name : str
    folder : Path
        A recording, with rig, scene and truth beside it.
    frames : int
    seconds : float
        Time of the last frame [s].
    status : str
        Of the simulation.
    video : Path or None
        A copy as one video file.
    """

    name: str
    folder: Path
    frames: int
    seconds: float
    status: str
    video: Path | None = None


def film(
    sources: list[str],
    out: Path,
    shooting: Shooting | None = None,
    *,
    project: Path = Path(),
    limit: int | None = None,
    video: Path | None = None,
    say: Say | None = None,
    progress: Progress | None = None,
) -> list[Filmed]:
    """Film scenes, plans and experiments.

    Parameters
    ----------
    sources : list of str
        Scene files, plan files, and ids or names of experiments of the project.
    out : Path
        Folder to make: the recording itself, or with several of them a folder of recordings.
    shooting : Shooting, optional
    project : Path
    limit : int, optional
        Only the first so many experiments of each plan.
    video : Path, optional
        Write the one film into this video file too, as a camera to play back.
    say : callable, optional
        Told in a sentence what takes long.
    progress : callable, optional
        Called as `progress(done, total)` after every frame of a film.

    Raises
    ------
    InvalidInput
        Nothing to film, or a rig, looks or folder that cannot be.
    """
    shooting = shooting or Shooting()
    rig = rig_of(shooting.rig)
    looks = _looks(shooting.looks, rig)
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
    for shot in _prepared(items, say):
        folder = out / shot.name if count > 1 else out
        filmed.append(_shoot(shot, folder, rig, looks, shooting, video, progress))
    return filmed


class Truth(NamedTuple):
    """What really is at every frame of a film.

    Attributes
    ----------
    time : (n,) float64
        [s]
    pose : dict of str to (n, 3) float64
        Of bodies and pushers in the middle of the exposure [m, m, rad].
    touches : (n, n_fixel) bool
        Whether the object touches each fixel of the scene.
    reading : (n,) int64
        The tactile byte as reported, false and missed contacts included; -1 without fixels.
    light : (n, 3) float64
        Factors of blue, green and red [-].
    covered : (n,) float64
        Share of the object's upper face under the hand [-].
    """

    time: FloatArray
    pose: dict[str, FloatArray]
    touches: BoolArray
    reading: NDArray[np.int64]
    light: FloatArray
    covered: FloatArray


def tracks_of(shot: Shot, lead: float) -> dict[str, Trajectory]:
    """True trajectories on the clock of a film that begins with a rest [s]."""
    simulation = shot.simulation
    tracks = {}
    for name, pose in simulation.pose.items():
        known = np.isfinite(pose).all(axis=1)
        tracks[name] = Trajectory(time=lead + simulation.time[known], pose=pose[known])
    return tracks


def truth_of(shot: Shot, rig: Rig, looks: Looks, times: FloatArray, shooting: Shooting) -> Truth:
    """What really is at the frames of a film taken at instants (n,) [s]."""
    tracks = tracks_of(shot, shooting.lead)
    occlusion = occlusion_of(shot.scene, rig, looks, times, shooting.seed)
    name = shot.scene.bodies[0].name
    covered = []
    for time in times.tolist():
        poses = poses_at(tracks, time, occlusion, shot.scene)
        covered.append(occlusion.share(poses.get("hand"), poses[name]))
    touches = _touches(shot, times - shooting.lead)
    return Truth(
        time=times,
        pose={name: track.at(times) for name, track in tracks.items()},
        touches=touches,
        reading=_readings(shot, rig, times, touches, shooting.seed),
        light=light(looks, times, shooting.seed),
        covered=np.array(covered),
    )


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


def _prepared(items: Iterator[Shot], say: Say | None) -> Iterator[Shot]:
    """The shots, after a word about what the first one waits for."""
    from fixel.testing.scenes import sliding_block

    get_ready(sliding_block(), say)
    yield from items


def _shoot(
    shot: Shot,
    folder: Path,
    rig: Rig,
    looks: Looks,
    shooting: Shooting,
    video: Path | None,
    progress: Progress | None,
) -> Filmed:
    duration = shooting.lead + float(shot.simulation.time[-1]) + shooting.rest
    times = frame_times(duration, shooting.rate, looks, shooting.seed)[: shooting.frames]
    truth = truth_of(shot, rig, looks, times, shooting)
    frames = film_scene(
        shot.scene, tracks_of(shot, shooting.lead), rig, looks, times, shooting.seed
    )
    header = RecordingHeader(
        size=rig.camera.lens.image_size,
        codec=shooting.codec,
        rig=rig.name,
        source=f"fixel testbed film of {shot.name}",
        started=STARTED,
        rate=shooting.rate,
        about={"simulated": True, "seed": shooting.seed},
    )
    folder.parent.mkdir(parents=True, exist_ok=True)
    _write_frames(frames, truth, folder, header, video, progress)
    save_rig(rig, folder / RIG_FILE)
    save_scene(shot.planned, folder / SCENE_FILE)
    _write_truth(shot, truth, looks, shooting, folder)
    return Filmed(
        name=shot.name,
        folder=folder,
        frames=len(times),
        seconds=float(times[-1]),
        status=shot.simulation.status,
        video=video,
    )


def _write_frames(
    frames: Iterator[Frame],
    truth: Truth,
    folder: Path,
    header: RecordingHeader,
    video: Path | None,
    progress: Progress | None,
) -> None:
    total = len(truth.time)
    with ExitStack() as stack:
        writer = stack.enter_context(RecordingWriter(folder, header))
        copy = None
        if video is not None:
            copy = stack.enter_context(VideoWriter(video, header.size, rate=header.rate))
        for k, frame in enumerate(frames):
            reading = int(truth.reading[k])
            writer.write(frame, None if reading < 0 else reading, frame.time)
            if copy is not None:
                copy.write(frame)
            if progress is not None:
                progress(k + 1, total)


def _write_truth(shot: Shot, truth: Truth, looks: Looks, shooting: Shooting, folder: Path) -> None:
    """`truth.npz`, frame by frame, and `truth.json`; whoever tracks must not look at them."""
    arrays: dict[str, Any] = {
        "time_s": truth.time,
        "touches": truth.touches,
        "reading": truth.reading,
        "light": truth.light,
        "covered": truth.covered,
        **{f"pose_{name}": pose for name, pose in truth.pose.items()},
    }
    with written_whole(folder / TRUTH_ARRAYS) as unfinished:
        np.savez_compressed(unfinished, **arrays)
    simulation = shot.simulation
    content = {
        "name": shot.name,
        "seed": shooting.seed,
        "testbed_seed": shot.testbed.seed,
        "looks": asdict(looks),
        "status": simulation.status,
        "motion_s": [shooting.lead, shooting.lead + float(simulation.time[-1])],
        "bodies": [body.name for body in shot.scene.bodies],
        "pushers": [pusher.name for pusher in shot.scene.pushers],
        "fixels": [fixel.name for fixel in shot.scene.fixels],
        "conditions": dict(shot.truth),
    }
    with written_whole(folder / TRUTH) as unfinished:
        unfinished.write_text(json.dumps(content, indent=1, allow_nan=False), encoding="utf-8")


def _touches(shot: Shot, times: FloatArray) -> BoolArray:
    """(n, n_fixel) at instants of the simulation; before its begin none has moved."""
    simulation = shot.simulation
    sample = np.searchsorted(simulation.time, times, side="right") - 1
    return np.asarray(touching(simulation)[np.clip(sample, 0, len(simulation.time) - 1)])


def _readings(
    shot: Shot, rig: Rig, times: FloatArray, touches: BoolArray, seed: int
) -> NDArray[np.int64]:
    """(n,) bytes as the fixels report them: a bit a coil, in the rig's order."""
    names = [fixel.name for fixel in shot.scene.fixels]
    if not names:
        return np.full(len(times), -1, np.int64)
    random = stream(seed, "film", "tactile", shot.name)
    wrong = shot.testbed.false_contact, shot.testbed.missed_contact
    reported = tactile_channel(times, touches, *wrong, random).values.astype(np.int64)
    total = np.zeros(len(times), np.int64)
    for bit, name in enumerate(rig.tactile):
        if name in names:
            total |= reported[:, names.index(name)] << bit
    return total
