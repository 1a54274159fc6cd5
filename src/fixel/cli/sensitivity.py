"""`fixel sensitivity`: outcomes of pushes over the error of their start."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from fixel.cli.options import (
    AnySeed,
    AsJson,
    CalibrationEngine,
    ProjectFolder,
    argument,
    option,
    require_folder,
    with_options,
)
from fixel.cli.screen import (
    command_line,
    command_of,
    print_answer,
    seconds,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.uncertainty.starts import StartError
    from fixel.workflows.sensitivity.request import SensitivityRequest
    from fixel.workflows.sensitivity.run import SensitivityAnswer

KINDS_OF_SIZES: Final = "--uniform (they are half-widths) or --normal (standard deviations)"


@dataclass(frozen=True, kw_only=True)
class SensitivityOptions:
    """Options of `fixel sensitivity` for the analysis."""

    calibration: int | None = option(
        None,
        "Stored calibration whose parameters are used.",
        metavar="ID",
        show_default="the newest; nominal values if there is none",
    )
    engine: CalibrationEngine = None
    set_: list[str] | None = option(
        None, "Value of a parameter; may be repeated.", "--set", metavar="NAME=VALUE"
    )
    start_error_mm: float | None = option(
        None, "Size of the start error along x and y, with --uniform or --normal.  [default: 0.3]"
    )
    start_error_deg: float | None = option(
        None, "Size of the start error of the angle, with --uniform or --normal.  [default: 0.5]"
    )
    preset: str | None = option(
        None,
        "Preset start error instead: asme (+-5 um, +-0.5 deg) or rpi-camera (noise of the camera "
        "at RPI).",
        show_default=False,
    )
    uniform: bool | None = option(
        None,
        "Sizes are half-widths (uniform) or standard deviations (normal). A size needs one of "
        "them; without any size the default is uniform.",
        "--uniform/--normal",
        show_default=False,
    )
    samples: int = option(1000, "Number of perturbed starts of each push.", min=50)
    indices: bool = option(
        False, "Also compute Sobol indices (needs SALib).", "--indices/--no-indices"
    )
    vary: list[str] | None = option(
        None,
        "Uncertain parameter for the indices; may be repeated. By default the intervals of the "
        "calibration.",
        metavar="NAME=LOW:HIGH",
    )
    base: int = option(128, "Number of base samples of the indices, a power of two.")
    seed: AnySeed = 0
    threads: int | None = option(None, "Number of threads; all cores by default.", min=1)

    @property
    def request(self) -> "SensitivityRequest":
        """Request of the analysis."""
        from fixel.workflows.sensitivity.request import SensitivityRequest

        return SensitivityRequest(
            error=self._error,
            samples=self.samples,
            values=dict(map(_value, self.set_ or ())),
            ranges=dict(map(_range, self.vary or ())),
            calibration=self.calibration,
            engine=self.engine or "",
            indices=self.indices or bool(self.vary),
            base=self.base,
            seed=self.seed,
            threads=self.threads,
        )

    @property
    def _error(self) -> "StartError":
        from fixel.uncertainty.starts import StartError, preset

        mm, deg = self.start_error_mm, self.start_error_deg
        if self.preset is not None:
            if mm is not None or deg is not None or self.uniform is not None:
                raise InvalidInput(
                    "--preset", found="a preset and a start error", expected="one of them"
                )
            return preset(self.preset)
        if self.uniform is None and (mm is not None or deg is not None):
            raise InvalidInput("the start error", found="sizes alone", expected=KINDS_OF_SIZES)
        place = 1e-3 * (0.3 if mm is None else mm)
        angle = math.radians(0.5 if deg is None else deg)
        kind: Literal["normal", "uniform"] = "normal" if self.uniform is False else "uniform"
        return StartError(x=place, y=place, theta=angle, kind=kind)


@with_options
def sensitivity(
    *,
    things: list[str] | None = argument(
        None,
        "Experiments (id, name or DATASET/NAME) or scene files; by default all experiments with "
        "a scene.",
        metavar="[EXPERIMENT|SCENE.yaml]...",
        show_default=False,
    ),
    project: ProjectFolder = Path(),
    options: SensitivityOptions,
    plot: Path | None = option(
        None, "Folder for copies of the charts.", metavar="FOLDER", file_okay=False
    ),
    as_json: AsJson = False,
) -> None:
    """Report how start errors grow, and pushes with several ends."""
    from fixel.database.project import Project
    from fixel.workflows.compilation import get_ready
    from fixel.workflows.figures import write_picture
    from fixel.workflows.sensitivity.run import analyse_sensitivity

    request = options.request
    require_folder(plot)
    answer = analyse_sensitivity(
        things or (),
        request,
        lambda: Project(project),
        command=command_line(),
        ready=get_ready,
    )
    files = []
    if plot is not None and answer.kept is not None:
        files = answer.kept.copy_pictures(plot)
    elif plot is not None:
        files = [path for picture in answer.pictures for path in write_picture(plot, picture)]
    print_answer(
        as_json, lambda: _content(answer, files), lambda: _lines(answer, files, plot, project)
    )


def _value(text: str) -> tuple[str, float]:
    from fixel.model import Parameters

    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise InvalidInput("--set", found=repr(text), expected="NAME=VALUE") from None
    return name.strip(), Parameters({name.strip(): number})[name.strip()]


def _range(text: str) -> tuple[str, tuple[float, float]]:
    from fixel.model.parameters import info_of

    name, _, interval = text.partition("=")
    low, _, high = interval.partition(":")
    info_of(name.strip())
    try:
        return name.strip(), (float(low), float(high))
    except ValueError:
        raise InvalidInput("--vary", found=repr(text), expected="NAME=LOW:HIGH") from None


def _content(answer: "SensitivityAnswer", files: list[Path]) -> dict[str, Any]:
    return {
        "headline": list(answer.analysis.headline),
        "warnings": list(answer.analysis.warnings),
        **answer.analysis.numbers,
        "folder": None if answer.kept is None else str(answer.kept.folder),
        "files": [str(path) for path in files],
    }


def _lines(
    answer: "SensitivityAnswer", files: list[Path], plot: Path | None, project: Path
) -> list[str]:
    analysis = answer.analysis
    lines = [*analysis.headline, ""]
    for table in analysis.tables:
        lines += [table.title, *table.lines(), ""]
    lines += [f"Note: {warning}" for warning in analysis.warnings]
    lines.append(f"Took {seconds(analysis.seconds)}.")
    if answer.kept is not None:
        lines.append(f"stored in {answer.kept.folder}")
    if files:
        lines.append(f"wrote {len(files)} files to {plot}")
    lines.append(f"Next: {_next(answer, plot, project)}")
    return lines


def _next(answer: "SensitivityAnswer", plot: Path | None, project: Path) -> str:
    """Return the command that most users need next."""
    again = answer.analysis.command or "fixel sensitivity"
    if plot is None:
        return f"{again} --plot sensitivity"
    if answer.findings[0].sensitivity.indices is None:
        return f"{again} --indices"
    if answer.kept is not None:
        return command_of("report", project=project)
    return f"{again} --samples {10 * len(answer.findings[0].sensitivity.prediction.reasons)}"
