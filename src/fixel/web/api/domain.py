"""Domain of applicability: stored maps at any threshold."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from fixel.domain.claim import Claim
from fixel.web.context import Context, ProjectContext
from fixel.web.values import Answer
from fixel.web.views import domain_views
from fixel.web.views.domain_views import MapDocument, MapView, SuggestedExperiment, ThresholdMap

router = APIRouter(prefix="/domain", tags=["domain"])


class NextExperiments(Answer):
    """Experiments to try next."""

    proposals: list[SuggestedExperiment]


class ClaimQuery(BaseModel):
    """Claim that a map is checked for; by default the one that it was made for."""

    threshold: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="threshold [mm], or as a share above the smallest error of the experiment",
    )
    level: float | None = Field(None, gt=0.0, lt=1.0)
    confidence: float | None = Field(None, gt=0.5, lt=1.0)

    def claim(self, view: MapView) -> Claim:
        """Return the claim for a map."""
        return replace(view.domain.claimed, **self.model_dump(exclude_none=True))


def _view(context: ProjectContext, name: str) -> MapView:
    return context.domain(name, domain_views.find_map(context.project, name).analysis.created)


@router.get("/{name}", summary="Get a map for all thresholds")
def view(context: Context, name: str) -> MapDocument:
    return domain_views.document(_view(context, name))


@router.get("/{name}/map", summary="Get the map at a threshold")
def at_threshold(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> ThresholdMap:
    one = _view(context, name)
    return domain_views.at_threshold(one, query.claim(one), context.folder)


@router.get("/{name}/next", summary="Get suggested experiments")
def next_experiments(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> NextExperiments:
    one = _view(context, name)
    return NextExperiments(proposals=domain_views.suggested(one, query.claim(one)))
