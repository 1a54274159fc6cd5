"""Track a film or recording, draw the tracks and store them as an experiment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.database.project import Project, typed
from fixel.datasets.base import origin_of
from fixel.drawing import palette
from fixel.drawing.chart import PICTURE_ENDINGS, require_file
from fixel.errors import InvalidInput
from fixel.formats.recording import RIG_FILE, SCENE_FILE, is_recording, open_recording
from fixel.formats.rig_file import rig_of
from fixel.formats.scene_file import load_scene
from fixel.formats.video_file import ENDINGS, VideoWriter, open_video
from fixel.io.atomic import written_whole
from fixel.model import Experiment, Scene
from fixel.typing import ProgressCallback
from fixel.vision.frame import Frame, Picture
from fixel.vision.marks import Rig
from fixel.vision.outlines import bgr, draw_outline, draw_words, outline_pixels
from fixel.vision.tracking import AUTO, FilmTracks, track
from fixel.vision.tracking.base import ActuatorMotion
from fixel.vision.tracking.follow import things_of
from fixel.workflows.acquisition.tracked_experiment import Readings, actuator_motion, experiment_of

DATASET: Final = "bench"
SHOWN: Final = 6  # frames on a sheet
ACROSS: Final = 2  # frames side by side
WIDTH: Final = 960  # [px] largest width of a frame on a sheet


@dataclass(slots=True, kw_only=True)
class Film:
    """Video file or recording, with its metadata."""

    path: Path
    video: Path  # file with the pictures
    frames: Callable[[], Iterator[Frame]]  # returns a new iterator over all frames at every call
    n_frames: int | None
    readings: Readings | None
    # Returns sentences about the file; complete after its frames have been read.
    remarks: Callable[[], tuple[str, ...]]
    simulated_by: str = ""


class TrackAnswer(NamedTuple):
    """Result of tracking a film."""

    film: Film
    rig: Rig
    tracked: FilmTracks
    motion: ActuatorMotion | None  # motion of the actuator
    experiment: Experiment
    number: int | None  # experiment id in the project; None if it was not stored
    new: bool  # whether the experiment was not yet in the project
    files: dict[str, Path]  # files written, under `overlay`, `sheet` and `plot`

    def summary(self) -> dict[str, Any]:
        """Return the results as plain values, ready for JSON."""
        experiment, motion = self.experiment, self.motion
        return {
            "source": str(self.film.path),
            "experiment": experiment.key,
            "id": self.number,
            "new": self.new,
            "rig": self.rig.name,
            "method": self.tracked.method,
            "frames": len(self.tracked.time),
            "seconds": float(self.tracked.time[-1] - self.tracked.time[0]),
            "parts": {name: _part(part) for name, part in self.tracked.parts.items()},
            "fixels": {
                fixel.name: {
                    "place_m": fixel.place.tolist(),
                    "scatter_m": fixel.scatter,
                    "frames": fixel.n,
                }
                for fixel in self.tracked.fixels
            },
            "actuator": None
            if motion is None or not motion.moved
            else {"speed_m_s": motion.cruise, "travel_m": motion.travel},
            "effective_s": None if experiment.effective is None else list(experiment.effective),
            "contact_mode": experiment.contact_mode,
            "scene": experiment.scene is not None,
            "flags": [{"name": f.name, "detail": f.detail} for f in experiment.flags],
            "files": {kind: str(path) for kind, path in self.files.items()},
        }


def track_film(
    source: Path,
    *,
    rig: str = "",
    scene: Path | None = None,
    method: str = AUTO,
    register: bool = False,
    project: Path | None = None,
    dataset: str = DATASET,
    name: str = "",
    overlay: Path | None = None,
    sheet: Path | None = None,
    plot: Path | None = None,
    progress: ProgressCallback | None = None,
) -> TrackAnswer:
    """Track a film, a video file or the folder of a recording, and store it as an experiment.

    The arguments are options of `fixel track`; `register` estimates the camera pose again. Without
    a project, nothing is stored. `progress` is called as `progress(done, total)`.
    """
    wanted = {"overlay": overlay, "sheet": sheet, "plot": plot}
    endings = {"overlay": ENDINGS, "sheet": (".png",), "plot": PICTURE_ENDINGS}
    files = {kind: path for kind, path in wanted.items() if path is not None}
    for kind, path in files.items():
        require_file(path, endings[kind], kind)
    opened = None if project is None else Project(project)
    film = open_film(source)
    marked = rig_of(rig or _file_next_to(source, RIG_FILE, "rig"))
    planned = load_scene(scene or _file_next_to(source, SCENE_FILE, "scene")).scene
    tracked = track(
        film.frames(),
        marked,
        planned,
        method=method,
        register=register,
        progress=_counted(progress, film.n_frames),
    )
    experiment = experiment_of(
        tracked,
        marked,
        planned,
        film.readings,
        dataset=dataset,
        name=name or source.stem,
        provenance=replace(origin_of(film.video), command=typed()),
        simulated_by=film.simulated_by,
        remarks=film.remarks(),
    )
    _draw(film, planned, tracked, experiment, files)
    number, new = None, False
    if opened is not None:
        with opened.store() as store:
            experiment = replace(experiment, video=store.add_video(film.video))
            number, new, _ = store.add_experiment(experiment)
    found = actuator_motion(tracked, planned)
    return TrackAnswer(
        film=film,
        rig=marked,
        tracked=tracked,
        motion=None if found is None else found[1],
        experiment=experiment,
        number=number,
        new=new,
        files=files,
    )


def open_film(source: Path) -> Film:
    """Open a video file, or the folder of a recording."""
    if is_recording(source):
        recording = open_recording(source)
        when = np.where(np.isfinite(recording.reading_time), recording.reading_time, recording.time)
        return Film(
            path=source,
            video=recording.video,
            frames=recording.frames,
            n_frames=recording.n_frames,
            readings=Readings(time=when, value=recording.readings),
            remarks=lambda: recording.problems,
            simulated_by=recording.header.simulated_by,
        )
    if source.is_dir():
        raise InvalidInput(
            str(source), found="a folder without a recording", expected="a video or a recording"
        )
    video = open_video(source)
    return Film(
        path=source,
        video=source,
        frames=video.frames,
        n_frames=video.n_frames,
        readings=None,
        remarks=lambda: tuple(video.remarks),
        simulated_by=video.note if video.note.startswith("SIMULATED") else "",
    )


def _file_next_to(source: Path, name: str, argument: str) -> Path:
    folder = source if source.is_dir() else source.parent
    if not (folder / name).is_file():
        found = f"no {name} next to the film"
        raise InvalidInput(argument, found=found, expected="that file, or another")
    return folder / name


def _draw(
    film: Film, scene: Scene, tracked: FilmTracks, experiment: Experiment, files: dict[str, Path]
) -> None:
    from fixel.drawing.chart import save_figure
    from fixel.drawing.tracking import track_figure

    if "overlay" in files:
        write_overlay(film.frames(), scene, tracked, files["overlay"], film.simulated_by)
    if "sheet" in files:
        write_sheet(film.frames(), scene, tracked, files["sheet"])
    if "plot" in files:
        save_figure(lambda: track_figure(tracked, experiment.effective), files["plot"])


def _counted(progress: ProgressCallback | None, total: int | None) -> Callable[[int], None] | None:
    if progress is None or not total:
        return None
    return lambda done: progress(min(done, total), total)


def _part(part: Any) -> dict[str, Any]:
    good = part.good
    return {
        "frames": int(good.sum()),
        "outliers": part.n_outliers,
        "residual_px": float(np.median(part.residual[good])),
        "residual_m": float(np.median(part.residual_m[good])),
        "sd_m": float(np.median(part.total_sd[good, :2])),
        "sd_rad": float(np.median(part.total_sd[good, 2])),
        "camera_sd_m": None
        if part.camera_sd is None
        else float(np.median(part.camera_sd[good, :2])),
        "gaps": [{"from_s": a, "to_s": b, "reason": why} for a, b, why in part.gaps],
    }


def write_overlay(
    frames: Iterator[Frame], scene: Scene, tracked: FilmTracks, path: Path, note: str = ""
) -> None:
    """Write the film with outlines of object, pusher and fixels at their heights."""
    step = float(np.median(np.diff(tracked.time))) if len(tracked.time) > 1 else 1.0 / 30.0
    zero = float(tracked.time[0])
    size = tuple(2 * (side // 2) for side in tracked.rig.camera.lens.image_size)
    with VideoWriter(path, (size[0], size[1]), rate=1.0 / step, note=note) as writer:
        for index, frame in enumerate(frames):
            picture = drawn(frame, index, scene, tracked)
            writer.write(Frame(frame.time - zero, picture[: size[1], : size[0]]))


def write_sheet(frames: Iterator[Frame], scene: Scene, tracked: FilmTracks, path: Path) -> None:
    """Write a few frames of the overlay as one picture."""
    from fixel.vision.frame import opencv

    cv2 = opencv()
    n = len(tracked.time)
    wanted = set(np.linspace(0, n - 1, min(SHOWN, n)).round().astype(int).tolist())
    shown = []
    for index, frame in enumerate(frames):
        if index in wanted:
            picture = drawn(frame, index, scene, tracked)
            scale = min(1.0, WIDTH / picture.shape[1])
            shown.append(
                cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            )
    while len(shown) % ACROSS:
        shown.append(np.full_like(shown[0], 255))
    rows = [np.hstack(shown[k : k + ACROSS]) for k in range(0, len(shown), ACROSS)]
    with written_whole(path) as unfinished:
        if not cv2.imwrite(str(unfinished), np.vstack(rows)):
            raise InvalidInput(str(path), found="no free disk space", expected="a file to write")


def drawn(frame: Frame, index: int, scene: Scene, tracked: FilmTracks) -> Picture:
    """Return a frame with the measured outlines drawn on it."""
    picture = np.array(frame.picture)
    rig, camera = tracked.rig, tracked.rig.camera
    places = {fixel.name: fixel.place for fixel in tracked.fixels}
    for fixel in scene.fixels:
        pose = np.append(places.get(fixel.name, fixel.pose[:2]), fixel.pose[2])
        line = outline_pixels(camera, fixel.shape, pose, rig.fixel_height)
        # Fixels that are only planned are dashed.
        dash = None if fixel.name in places else 4.0
        draw_outline(picture, line, bgr(palette.TOUCHED), dash=dash)
    things = things_of(scene)
    pushers = {pusher.name for pusher in scene.pushers}
    missing = []
    for name, part in tracked.parts.items():
        if not part.good[index]:
            missing.append(f"{name}: {part.reason[index]}")
            continue
        if name in things:
            line = outline_pixels(
                camera, things[name].shape, part.pose[index], rig.parts[name].height
            )
            colour = palette.PUSHER if name in pushers else palette.TRAIL
            draw_outline(picture, line, bgr(colour))
    draw_words(picture, f"{frame.time:.3f} s", (8, 24), (255, 255, 255))
    for row, words in enumerate(missing):
        draw_words(picture, words, (8, 50 + 24 * row), bgr(palette.FORCE))
    return picture
