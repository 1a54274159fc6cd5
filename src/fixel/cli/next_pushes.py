"""`fixel next`: which pushes of a part to make next."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fixel.cli.options import (
    AsJson,
    PictureFolder,
    ProjectFolder,
    Seed,
    Where,
    option,
    require_folder,
    with_options,
)
from fixel.cli.screen import (
    command_of,
    notice,
    paragraphs,
    print_answer,
    seconds,
    wrote,
)

if TYPE_CHECKING:
    from fixel.workflows.analysis import StoredAnalysis
    from fixel.workflows.next_pushes.run import NextPushesRequest, PushProposal


@dataclass(frozen=True, kw_only=True)
class NextOptions:
    """Options of `fixel next` for the part and the pushes that can be made."""

    part: str | None = option(
        None, "Part to push, such as hex or shape=hex.", metavar="PART", show_default=False
    )
    surface: str | None = option(
        None,
        "Surface that it stands on, such as abs or table=abs.",
        metavar="SURFACE",
        show_default="that of its experiments",
    )
    scene: Path | None = option(
        None, "Scene file of a part without experiments.", exists=True, dir_okay=False
    )
    candidates: Path | None = option(
        None,
        "Plan file with the pushes that can be made; by default they are generated around the"
        " outline.",
        exists=True,
        dir_okay=False,
    )
    number: int = option(5, "Number of pushes to propose.", "--number", "-n", min=1, max=100)
    chosen: bool = option(
        False, "State that the part's pushes so far were proposed by this command.", "--chosen"
    )
    contacts: int = option(24, "Number of contacts around the outline.", min=1, max=1000)
    travel_mm: float | None = option(
        None, "Travel of the pusher [mm].", show_default="median of the experiments"
    )
    speed_mm_s: float | None = option(
        None, "Speed of the pusher [mm/s].", show_default="median of the experiments"
    )
    radius_mm: float | None = option(
        None, "Radius of the pusher [mm].", show_default="that of the experiments"
    )
    where: Where = None
    seed: Seed = 0

    @property
    def request(self) -> "NextPushesRequest":
        """Request for the next pushes."""
        from fixel.model.fields import optional_positive
        from fixel.workflows.next_pushes.run import NextPushesRequest

        lengths = {
            name: None if value is None else 1e-3 * (optional_positive(value, option, "") or 0.0)
            for name, value, option in (
                ("travel", self.travel_mm, "--travel-mm"),
                ("speed", self.speed_mm_s, "--speed-mm-s"),
                ("radius", self.radius_mm, "--radius-mm"),
            )
        }
        return NextPushesRequest(
            part=self.part or "",
            surface=self.surface or "",
            scene="" if self.scene is None else str(self.scene),
            candidates="" if self.candidates is None else str(self.candidates),
            where=tuple(self.where or ()),
            n=self.number,
            chosen=self.chosen,
            contacts=self.contacts,
            seed=self.seed,
            **lengths,
        )


@with_options
def next_(
    *,
    folder: ProjectFolder = Path(),
    options: NextOptions,
    out: Path | None = option(None, "Write the proposed pushes to this plan file: .yaml.", "--out"),
    plot: PictureFolder = None,
    as_json: AsJson = False,
) -> None:
    """Propose which pushes of a part to make next.

    Each is the push that reduces the expected error of all candidates most. Other parts of the
    project contribute what parts have in common.
    """
    from fixel.database.project import Project
    from fixel.workflows.next_pushes import plan, report, run

    request = options.request
    require_folder(plot)
    if out is not None:
        plan.refuse_plan(out)
    project = Project(folder)
    found = run.propose_pushes(project, request, notify=notice(as_json))
    kept = report.store_proposal(project, found, report.command_of(request, folder))
    files = [] if plot is None else kept.copy_pictures(plot)
    if out is not None:
        files.insert(0, plan.write_plan(found, out))
    print_answer(
        as_json,
        lambda: _content(kept, files),
        lambda: _lines(found, kept, files, out, folder),
    )


def _content(kept: "StoredAnalysis", files: list[Path]) -> dict[str, Any]:
    return kept.analysis.numbers | {"folder": str(kept.folder), "files": [str(f) for f in files]}


def _lines(
    found: "PushProposal", kept: "StoredAnalysis", files: list[Path], out: Path | None, folder: Path
) -> list[str]:
    """About a screen of text: what is unseen, the pushes, the bounds, the next command."""
    analysis = kept.analysis
    n_unseen = len(found.pushes.unseen)
    return paragraphs(
        [f"Unseen: {text}" for text in found.pushes.unseen],
        [
            f"{analysis.title}, after {found.pushes.pushes} pushes"
            f" ({found.pushes.candidates} candidates)",
            *found.pushes.table().lines(),
            found.pushes.notes[0],
        ],
        [*analysis.headline, *(f"Warning: {text}" for text in analysis.warnings[n_unseen:])],
        [*wrote(files), f"stored in {kept.folder}, in {seconds(found.seconds)}"],
        [f"Next: {_next(analysis.command, out, folder)}"],
    )


def _next(command: str, out: Path | None, folder: Path) -> str:
    """Return the command that performs the pushes, or the one that writes them to a file."""
    if out is not None:
        return command_of("testbed", "run", out, project=folder)
    return f"{command} --out next.yaml"
