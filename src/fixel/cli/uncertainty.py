"""`fixel uncertainty`: posterior of the parameters, and predictions of paths and poses."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fixel.cli.options import (
    AsJson,
    Engine,
    MeasurementNoise,
    PictureFolder,
    ProjectFolder,
    Seed,
    argument,
    engine_or_motion,
    option,
    require_folder,
    with_options,
)
from fixel.cli.screen import (
    command_line,
    compare_command,
    print_answer,
    seconds,
    wrote,
)
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.uncertainty.run import Uncertainty, UncertaintyRequest


@dataclass(frozen=True, kw_only=True)
class UncertaintyOptions:
    """Options of `fixel uncertainty` for the posterior."""

    calibration: int | None = option(
        None,
        "Stored calibration whose parameters, motion model and experiments are used.",
        metavar="ID",
        show_default=False,
    )
    fit: list[str] | None = option(
        None,
        "Parameter to infer, in SI units or with the suffix _mm, _deg or _mrad; may be repeated.",
        metavar="NAME[=LOW:HIGH]",
    )
    held_out: list[str] | None = option(
        None, "Experiment that is only predicted; may be repeated.", metavar="NAME"
    )
    motion: str | None = option(
        None,
        "Motion model: dynamic, quasistatic or first-order.",
        metavar="MODEL",
        show_default="that of the calibration, or dynamic",
    )
    engine: Engine = None
    noise: MeasurementNoise
    model_error: bool = option(
        True, "Whether to include model error as a separate term.", "--model-error/--no-model-error"
    )
    samples: int = option(1000, "Number of effective samples.", min=10)
    seed: Seed = 0

    def request(self, experiments: list[str]) -> "UncertaintyRequest":
        """Return the request for experiments, given by id or name."""
        from fixel.workflows.uncertainty.run import UncertaintyRequest

        return UncertaintyRequest(
            experiments=tuple(experiments),
            held_out=tuple(self.held_out or ()),
            calibration=self.calibration,
            fit=tuple(self.fit or ()),
            motion=engine_or_motion(self.engine, self.motion),
            noise=_noise(self.noise.noise_mm, self.noise.noise_mrad),
            model_error=self.model_error,
            samples=self.samples,
            seed=self.seed,
        )


@with_options
def uncertainty(
    *,
    experiments: list[str] | None = argument(
        None,
        "Ids or names of experiments; by default those of the calibration.",
        metavar="[EXPERIMENT]...",
    ),
    folder: ProjectFolder = Path(),
    options: UncertaintyOptions,
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Compute a posterior and predict the end of a repeated push.

    Priors are uniform within the bounds of the parameters.
    """
    from fixel.database.project import Project
    from fixel.workflows.uncertainty.report import store_uncertainty
    from fixel.workflows.uncertainty.run import find_uncertainty

    request = options.request(experiments or [])
    require_folder(plot)
    project = Project(folder)
    found = find_uncertainty(project, request)
    kept = store_uncertainty(project, found, command_line())
    pictures = [] if plot is None else kept.copy_pictures(plot)
    files = {"folder": str(kept.folder), "pictures": [str(path) for path in pictures]}
    print_answer(
        as_json,
        lambda: kept.analysis.numbers | files,
        lambda: _lines(found, kept, pictures, folder),
    )


def _noise(mm: float | None, mrad: float | None) -> tuple[float, float] | None:
    if (mm is None) != (mrad is None):
        raise InvalidInput(
            "--noise-mm" if mm is None else "--noise-mrad",
            found="only one of them",
            expected="both, or neither",
        )
    return None if mm is None or mrad is None else (1e-3 * mm, 1e-3 * mrad)


def _lines(
    found: "Uncertainty", kept: "StoredAnalysis", pictures: list[Path], folder: Path
) -> list[str]:
    analysis, posterior = kept.analysis, found.posterior
    lines = [f"Warning: {sentence}" for sentence in analysis.warnings]  # first: they limit the rest
    lines += analysis.headline
    for table in analysis.tables:
        lines += ["", table.title, *table.lines()]
    return [
        *lines,
        "",
        f"{posterior.effective:.0f} effective samples from {posterior.evaluations} simulated"
        f" points in {seconds(posterior.seconds)}; log evidence {posterior.log_evidence:.2f}"
        f" +- {posterior.log_evidence_error:.2f}",
        *wrote(pictures),
        f"stored in {kept.folder}",
        f"Next: {_next(found, folder)}",
    ]


def _next(found: "Uncertainty", folder: Path) -> str:
    """Return the next command: a comparison with the likeliest values."""
    first = found.predicted[0]
    n = len(found.space.free)
    columns = found.space.columns(found.posterior.best[None, :n], first.target.conditions)
    values = {name: float(column[0]) for name, column in columns.items()}
    return compare_command(first.target.key, values, found.motion, folder)
