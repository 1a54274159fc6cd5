"""Write charts of results as PNG, as PDF, and as CSV with their numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from fixel.drawing.chart import Chart, draw_chart
from fixel.io.atomic import usable, write_whole
from fixel.model import Experiment

ENDINGS: Final = ("png", "pdf", "csv")
MAX_BANNER: Final = 80  # characters of a banner that fit across a chart one column wide


class Picture(NamedTuple):
    """Chart with the name, banner and caption of its files."""

    name: str  # name of the files, without ending
    chart: Chart
    banner: str = ""  # text across the top, for experiments that no camera has seen
    caption: str = ""  # a sentence on what the chart shows


def banner_of(banners: Sequence[str]) -> str:
    """Combine the banners of several experiments into one; those of real ones are empty."""
    some = [banner for banner in banners if banner]
    if len(some) in (0, len(banners)):
        joined = " and ".join(dict.fromkeys(some))
        return joined if len(joined) <= MAX_BANNER else f"SIMULATED: all {len(some)} experiments"
    return f"{len(some)} of {len(banners)} experiments SIMULATED"


def banner_over(experiments: Iterable[Experiment]) -> str:
    """Return the banner over charts of experiments; empty if all are real."""
    return banner_of(
        ["" if one.real else f"SIMULATED by {one.simulated_by}" for one in experiments]
    )


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Create a folder for the files of the block; remove it if the block writes none."""
    missing = [own for own in (folder, *folder.parents) if not own.exists()]
    with usable(folder, "a folder to write to"):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # it is not empty
            for own in missing:
                own.rmdir()


def write_picture(folder: Path, picture: Picture) -> list[Path]:
    """Write the files of a picture, replacing those of the same names; return their paths."""
    paths = [folder / f"{picture.name}.{ending}" for ending in ENDINGS]
    draw_chart(picture.chart, *paths[:2], banner=picture.banner)
    write_whole(paths[2], picture.chart.table().csv())
    return paths


def write_pictures(folder: Path, pictures: Iterable[Picture]) -> list[Path]:
    """Write the files of pictures into a folder, which is created if missing."""
    with new_folder(folder):
        return [path for picture in pictures for path in write_picture(folder, picture)]
