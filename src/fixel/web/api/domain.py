"""Domain of applicability: stored maps at any threshold."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from fixel.web.context import Context, ProjectContext
from fixel.web.values import Answer
from fixel.web.views import domain_views
from fixel.web.views.domain_views import ClaimQuery, MapDocument, MapView, SuggestedExperiment
from fixel.workflows.analysis import find_analysis

router = APIRouter(prefix="/domain", tags=["domain"])


class NextExperiments(Answer):
    """Experiments to try next."""

    proposals: list[SuggestedExperiment]


def _view(context: ProjectContext, name: str) -> MapView:
    return context.domain(name, find_analysis(context.project, name, "domain").analysis.created)


@router.get("/{name}", summary="Get a map at a threshold")
def at_threshold(context: Context, name: str, query: Annotated[ClaimQuery, Query()]) -> MapDocument:
    one = _view(context, name)
    return domain_views.document(one, query.claim(one), context.folder)


@router.get("/{name}/next", summary="Get suggested experiments")
def next_experiments(
    context: Context, name: str, query: Annotated[ClaimQuery, Query()]
) -> NextExperiments:
    one = _view(context, name)
    return NextExperiments(proposals=domain_views.suggested(one, query.claim(one)))
