"""Acquire experiments with a camera: record, track, overlay, drive, and rendered films."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Seed
from fixel.errors import InvalidInput, check_name

if TYPE_CHECKING:
    from fixel.typing import ProgressCallback
    from fixel.workflows.acquisition.film import FilmResult

SOURCES: Final = Door(plain=tuple[str, ...], metavar="[EXPERIMENT|SCENE.yaml|PLAN.yaml]...")
Count = Annotated[int | None, Door(least=1, metavar="COUNT")]
Rest = Annotated[float, Door(least=0.0)]

Camera = Annotated[
    str,
    Door(
        metavar="SOURCE",
        meaning="Camera (0, /dev/video0, http://...), video file or folder of a recording.",
    ),
]
ENDS: Final = ("key", "limit", "seated")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordPlan:
    """Source, destination and end of a recording.

    Attributes
    ----------
    folder : Path
        New folder for the recording.
    tactile : str, optional
        Serial port of the tactile board; 'film' for the readings of a played recording, or
        film:FOLDER for those of another one.
    rig : str, optional
        Rig, by name or file; the pictures must have the size of its camera.
    scene : Path, optional
        Scene file of the experiment, stored with the recording.
    size : tuple of int, optional
        Picture size to request from the camera; without --rig only.
    rate : float
        Frame rate to request from the camera [frames/s].
    codec : str
        Codec. as-it-comes: JPEG of the camera, bit for bit; near: JPEG of high quality; exact:
        lossless, 5 times the size of near; auto: as-it-comes if the camera sends JPEG, else near.
    until : str
        End of the recording. key: Enter or Ctrl-C; limit: after --limit; seated: contact mode of
        --mode, or at rest.
    mode : str, optional
        Contact mode that counts as seated, one digit per fixel 1, 2, 3, such as 010.
    limit : float, optional
        Longest duration, such as 15s or 10min.
    fast : bool
        Play a file as fast as it can be read; time stamps stay those of the file.
    """

    camera: Camera
    folder: Annotated[Path, Door(flag="--out", metavar="FOLDER")]
    tactile: Annotated[str | None, Door(metavar="PORT", usual="none")] = None
    rig: Annotated[str | None, Door(metavar="RIG")] = None
    scene: Path | None = None
    size: Annotated[tuple[int, int] | None, Door(plain=str | None, metavar="WIDTHxHEIGHT")] = None
    rate: Annotated[float, Door(least=1.0)] = 30.0
    codec: Annotated[str, Door(metavar="NAME")] = "auto"
    until: Annotated[str, Door(metavar="WHEN")] = "key"
    mode: Annotated[str | None, Door(metavar="DIGITS")] = None
    limit: Annotated[float | None, Door(plain=str | None, metavar="DURATION")] = None  # [s]
    fast: Annotated[bool, Door(flag="--fast")] = False

    def __post_init__(self) -> None:
        from fixel.formats.recording import CODECS, is_recording

        for name, known in ("codec", ("auto", *CODECS)), ("until", ENDS):
            check_name(name, getattr(self, name), known)
        if self.until == "limit" and self.limit is None:
            raise InvalidInput("limit", found=None, expected="a duration such as 15s")
        if self.limit is not None and not (isfinite(self.limit) and self.limit > 0.0):
            raise InvalidInput("limit", found=f"{self.limit} s", expected="more than 0 s")
        if self.mode is not None and (self.until != "seated" or self.tactile is None):
            expected = "used with --until seated and --tactile"
            raise InvalidInput("mode", found=repr(self.mode), expected=expected)
        if self.folder.exists():
            what = "a recording" if is_recording(self.folder) else "an existing file or folder"
            raise InvalidInput(str(self.folder), found=what, expected="a new folder")


def film_experiments(
    sources: Annotated[Sequence[str], SOURCES] = (),
    *,
    out: Annotated[Path, Door(also=("-o",), metavar="FOLDER")] = Path("film"),
    rig: Annotated[str, Door(metavar="RIG")] = "thesis-tags",
    looks: Annotated[str, Door(metavar="NAME", usual="thesis, or microscope")] = "",
    changes: Annotated[tuple[str, ...], Door(flag="--set", metavar="NAME=VALUE")] = (),
    seed: Seed = 1,
    exact: Annotated[bool, Door(flag="--exact")] = False,
    video: Annotated[Path | None, Door(writes=True)] = None,
    rate: Annotated[float, Door(least=0.1, most=1000.0)] = 30.0,
    lead: Rest = 0.5,
    rest: Rest = 0.5,
    frames: Count = None,
    limit: Count = None,
    project: Path = Path(),
    progress: ProgressCallback | None = None,
) -> list[FilmResult]:
    """Render simulated experiments as recordings, to test tracking.

    Their true poses are known.

    Parameters
    ----------
    sources : sequence of str
        Scene files, plan files, or experiments of the project by id or name.
    out : Path
        New folder for the films.
    rig : str
        Rig file or name of an example rig: thesis-tags, thesis-stickers, microscope.
    looks : str
        Camera effects: clean, thesis, hard, microscope-clean or microscope.
    changes : tuple of str
        One value of the camera effects, such as occlusion=1.5; may be repeated.
    seed : int
        Seed of the random number generator.
    exact : bool
        Store pictures without loss, in larger files.
    video : Path, optional
        Also write the film as one video file: .mp4 or .mkv.
    rate : float
        Frame rate, from 0.1 to 1000 [Hz].
    lead : float
        Time at rest before the motion [s].
    rest : float
        Time at rest after the motion [s].
    frames : int, optional
        Maximum number of frames.
    limit : int, optional
        Maximum number of experiments to film from a plan.
    project : Path
        Folder of the project.
    progress : callable, optional
        Called as `progress(done, total)` after every frame.
    """
    from fixel.workflows.acquisition.film import filmed

    return filmed(FILM.asked(locals()), project, progress)


FILM: Final = Capability(name="film", function=film_experiments, plot="", group="testbed")
