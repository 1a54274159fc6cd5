"""Acquire experiments with a camera: record, track, overlay, drive, and rendered films."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door
from fixel.capability.usual import Seed

if TYPE_CHECKING:
    from fixel.typing import ProgressCallback
    from fixel.workflows.acquisition.film import FilmResult

SOURCES: Final = Door(plain=tuple[str, ...], metavar="[EXPERIMENT|SCENE.yaml|PLAN.yaml]...")
Count = Annotated[int | None, Door(least=1, metavar="COUNT")]
Rest = Annotated[float, Door(least=0.0)]


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
