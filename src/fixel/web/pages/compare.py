"""Page that compares sets of parameters on one experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from fastapi import Request

from fixel.database.query import ExperimentQuery
from fixel.errors import NotStored
from fixel.web.app import Page

if TYPE_CHECKING:
    from fixel.web.project import ProjectContext

OFFERED: Final = 300  # names in the list of experiments


def pages(desk: ProjectContext) -> list[Page]:
    """Page `/compare?experiment=KEY`."""

    def fill(request: Request) -> dict[str, Any]:
        listed = desk.store.experiments(ExperimentQuery(limit=OFFERED)).rows
        key = request.query_params.get("experiment", "")
        if not key and not listed:
            raise NotStored("experiment to compare with", hint="import some with: fixel import")
        number = desk.store.find(key) if key else listed[0].id
        experiment = desk.store.experiment(number)
        return {
            "title": f"Compare {experiment.key}",
            "number": number,
            "key": experiment.key,
            "keys": [summary.key for summary in listed],
        }

    return [Page(path="/compare", title="Compare", template="compare.html", fill=fill, place=20)]
