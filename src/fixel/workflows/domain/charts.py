"""Draw the charts of a domain map."""

from __future__ import annotations

from fixel.domain.claim import CellVerdict, Claim
from fixel.domain.domain import DomainMap
from fixel.drawing.domain import map_chart, size_chart
from fixel.workflows.figures import Picture
from fixel.workflows.sentences import sentences


def pictures_of(
    domain: DomainMap, claim: Claim, verdicts: list[list[CellVerdict]], banner: str = ""
) -> list[Picture]:
    """Charts of the map, one per axis if only one differs at a time, and of D(tau) by tau."""
    names = [axis.name for axis in domain.cells.axes]
    maps: dict[str, tuple[str, int, int | None]]
    if domain.cells.arms or len(names) == 1:
        maps = {f"map-{name}": (name, k, None) for k, name in enumerate(names)}
    else:
        maps = {"map": (" and ".join(names), 0, 1)}
    found = []
    for stem, (title, across, up) in maps.items():
        chart = map_chart(domain, claim, verdicts, across, up)
        (caption,) = sentences("domain", "map_caption", claim=claim, names=title)
        found.append(Picture(stem, chart, banner, caption))
    (caption,) = sentences("domain", "size_caption", claim=claim)
    return [*found, Picture("size", size_chart(domain, claim), banner, caption)]
