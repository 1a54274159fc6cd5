"""Propose the next pushes of a part of a project, from pushes of its other parts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from fixel.capability.capability import Capability
from fixel.capability.options import Door, Seed, Where

if TYPE_CHECKING:
    from fixel.database.project import Project
    from fixel.progress import ProgressOption
    from fixel.workflows.next_pushes.report import PushProposal

STORE: Final = Path("cache") / "parts"  # finished fits, in the project
THEIRS: Final = "median of the experiments"


def propose_pushes(
    project: Project,
    *,
    part: Annotated[str, Door(metavar="PART")] = "",
    surface: Annotated[str, Door(metavar="SURFACE", usual="that of its experiments")] = "",
    scene: Path | None = None,
    candidates: Path | None = None,
    number: Annotated[int, Door(also=("-n",), least=1, most=100)] = 5,
    chosen: bool = False,
    contacts: Annotated[int, Door(least=1, most=1000)] = 24,
    travel: Annotated[float | None, Door(unit="mm", above=0.0, usual=THEIRS)] = None,
    speed: Annotated[float | None, Door(unit="mm/s", above=0.0, usual=THEIRS)] = None,
    radius: Annotated[float | None, Door(unit="mm", above=0.0, usual=THEIRS)] = None,
    where: Where = (),
    seed: Seed = 0,
    out: Annotated[Path | None, Door(writes=True, effort=True)] = None,
    progress: ProgressOption = None,
) -> PushProposal:
    """Propose which pushes of a part to make next.

    Each push reduces the expected error of all candidates as much as possible. Other parts of the
    project contribute what parts have in common.

    Parameters
    ----------
    part : str
        Part to push, such as hex or shape=hex; none for the part of a scene file.
    surface : str
        Surface that it stands on, such as abs or table=abs.
    scene : Path, optional
        Scene file of a part without experiments.
    candidates : Path, optional
        Plan file with the pushes that can be made; by default they are generated around the
        outline.
    number : int
        Number of pushes to propose.
    chosen : bool
        Whether the part's pushes so far were proposed in this way.
    contacts : int
        Number of contacts around the outline.
    travel : float, optional
        Travel of the pusher.
    speed : float, optional
        Speed of the pusher.
    radius : float, optional
        Radius of the pusher.
    out : Path, optional
        Plan file, .yaml, to which the proposed pushes are written.

    Raises
    ------
    InvalidInput
        No experiments of other parts can be used, the part is unknown and has no scene, or no
        candidate moves it.
    """
    asked = NEXT.asked(locals())
    from fixel.drawing.chart import require_file
    from fixel.workflows.next_pushes import report
    from fixel.workflows.parts import part_model

    require_file(out, (".yaml", ".yml"), "plan")
    own = report.select(project, asked)
    fits = project.folder / STORE
    fits.mkdir(parents=True, exist_ok=True)
    model = part_model(
        own.known, part=own.part.name, surface=own.surface.name, seed=seed, store=fits,
        progress=progress,
    )  # fmt: skip
    if own.mine:
        model = model.after(own.mine, chosen=chosen, progress=progress)
    offered = own.offered or own.around(contacts, travel=travel, speed=speed, radius=radius)
    pushes = model.next_pushes(offered, n=number, **own.labels)
    scenes = tuple(offered[k] for k in pushes.order)
    found = report.PushProposal(own, model, pushes, scenes)
    if out is not None:
        report.write_plan(found, out)
    return found


NEXT: Final = Capability(name="next", title="Next pushes", function=propose_pushes, on_table=True)
