"""`fixel uncertainty`: posterior of the parameters, and predictions of paths and poses."""

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fixel.cli.options import AsJson, NoiseMm, NoiseMrad, PictureFolder, ProjectFolder, Seed
from fixel.errors import InvalidInput

if TYPE_CHECKING:
    from fixel.uncertainty.posterior import SamplerProgress
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.uncertainty.run import Uncertainty


def uncertainty(
    experiments: Annotated[
        list[str] | None,
        typer.Argument(
            help="Ids or names; those of the calibration where left out.",
            metavar="[EXPERIMENT]...",
        ),
    ] = None,
    folder: ProjectFolder = Path(),
    calibration: Annotated[
        int | None,
        typer.Option(
            help="Stored calibration whose parameters, motion model and experiments are taken.",
            metavar="NUMBER",
            show_default=False,
        ),
    ] = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            help="Parameter to ask for, in SI units or with _mm, _deg, _mrad after the name; may be"
            " repeated.",
            metavar="NAME[=LOW:HIGH]",
        ),
    ] = None,
    held_out: Annotated[
        list[str] | None,
        typer.Option(help="Experiment to be predicted only; may be repeated.", metavar="NAME"),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            help="dynamic, quasistatic or first-order.",
            metavar="MODEL",
            show_default="the calibration's, or dynamic",
        ),
    ] = None,
    noise_mm: NoiseMm = None,
    noise_mrad: NoiseMrad = None,
    model_error: Annotated[
        bool,
        typer.Option(
            "--model-error/--no-model-error", help="The model's own error as a term of its own."
        ),
    ] = True,
    samples: Annotated[int, typer.Option(help="Effective samples wanted.", min=10)] = 1000,
    seed: Seed = 0,
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Show how certain parameters are, and where the next push like this one ends.

    Priors are uniform within the bounds of the parameters.
    """
    from fixel.database.project import Project
    from fixel.workflows.uncertainty.report import keep_uncertainty
    from fixel.workflows.uncertainty.run import UncertaintyRequest, find_uncertainty

    request = UncertaintyRequest(
        experiments=tuple(experiments or ()),
        held_out=tuple(held_out or ()),
        calibration=calibration,
        fit=tuple(fit or ()),
        motion=motion,
        noise=_noise(noise_mm, noise_mrad),
        model_error=model_error,
        samples=samples,
        seed=seed,
    )
    if plot is not None:
        from fixel.workflows.figures import make_folder

        make_folder(plot)
    project = Project.open(folder)
    found = find_uncertainty(project, request, _bar())
    kept = keep_uncertainty(project, found, "fixel " + shlex.join(sys.argv[1:]))
    pictures = [] if plot is None else kept.copy_pictures(plot)
    if as_json:
        answer = kept.analysis.numbers | {
            "folder": str(kept.folder),
            "pictures": [str(path) for path in pictures],
        }
        typer.echo(json.dumps(answer, allow_nan=False))
        return
    typer.echo("\n".join(_lines(found, kept, pictures, folder)))


def _noise(mm: float | None, mrad: float | None) -> tuple[float, float] | None:
    if (mm is None) != (mrad is None):
        raise InvalidInput(
            "--noise-mm" if mm is None else "--noise-mrad",
            found="left out beside the other",
            expected="both, or neither",
        )
    return None if mm is None or mrad is None else (1e-3 * mm, 1e-3 * mrad)


def _bar() -> "Callable[[SamplerProgress], None] | None":
    from fixel.cli.screen import progress_bar

    show = progress_bar("Sampling")
    if show is None:
        return None
    highest = 0

    def tell(progress: "SamplerProgress") -> None:
        nonlocal highest
        share = round(1000.0 * progress.share)
        if share >= 1000 and progress.remaining > 0.0:
            share = 999
        highest = max(highest, share)
        show(highest, 1000)

    return tell


def _lines(
    found: "Uncertainty", kept: "StoredAnalysis", pictures: list[Path], folder: Path
) -> list[str]:
    from fixel.cli.screen import seconds

    analysis, posterior = kept.analysis, found.posterior
    lines = [f"Mind: {sentence}" for sentence in analysis.warnings]  # first: they limit the rest
    lines += analysis.headline
    for table in analysis.tables:
        lines += ["", table.title, *table.lines()]
    lines += [
        "",
        f"{posterior.effective:.0f} effective samples from {posterior.evaluations} simulated"
        f" points in {seconds(posterior.seconds)}; log evidence {posterior.log_evidence:.2f}"
        f" +- {posterior.log_evidence_error:.2f}",
    ]
    lines += [f"wrote {path}" for path in pictures]
    lines.append(f"kept in {kept.folder}")
    lines.append(f"Next: {_next(found, folder)}")
    return lines


def _next(found: "Uncertainty", folder: Path) -> str:
    """Return the next command: a comparison with the likeliest values."""
    from fixel.cli.screen import compare_command

    first = found.predicted[0]
    n = len(found.space.free)
    columns = found.space.columns(found.posterior.best[None, :n], first.target.conditions)
    values = {name: float(column[0]) for name, column in columns.items()}
    return compare_command(first.target.key, values, found.motion, folder)
