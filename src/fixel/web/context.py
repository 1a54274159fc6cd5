"""Context of a project, shared by its pages and its API."""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Final

from fastapi import Depends, Request

from fixel.database.project import Project
from fixel.drawing.thumbnail import thumbnail
from fixel.errors import StoreRefused
from fixel.model.selection import ExperimentQuery
from fixel.web.bench_session import BenchSession
from fixel.web.views.calibration_views import ProgressReader, StoredCalibration, load_detail, plot
from fixel.web.views.domain_views import load_view
from fixel.web.views.live_comparison import LiveComparison

MAX_KEPT: Final = 64  # details of calibrations in memory
MAX_MAPS: Final = 12  # domain maps in memory
MAX_THUMBNAILS: Final = 5000  # in memory; about 2 kB each


class ProjectContext:
    """Project, its store, and what is computed from them for more than one request."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self._place = self._found_place()
        self.store = project.store()  # opened once; any thread may use it
        # So that the first page does not wait for its statements.
        self.store.experiments(ExperimentQuery(include_faulty=True, limit=1), details=True)
        self.newest: dict[str, Any] = {}  # self-test and check of the database
        self.bench = BenchSession()
        self.comparison = LiveComparison(self.store)
        self.calibrations = ProgressReader(project, self.store)
        # A plot by id and kind, a thumbnail by id and checksum, a map by name and time.
        self._details = lru_cache(MAX_KEPT)(partial(load_detail, project, self.store))
        self.calibration_plot = lru_cache(MAX_KEPT)(partial(plot, project))
        self.thumbnail = lru_cache(MAX_THUMBNAILS)(
            lambda number, checksum: thumbnail(self.store.experiment(number))
        )
        self.domain = lru_cache(MAX_MAPS)(partial(load_view, project, self.store))

    @property
    def name(self) -> str:
        """Name of the project."""
        return self.project.settings.name

    def _found_place(self) -> tuple[int, int, bool] | None:
        """Return what the folder of the project is now: None without one, as on some servers."""
        try:
            found = self.project.folder.stat()
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_nlink > 0

    @property
    def here(self) -> ProjectContext:
        """This context; raise if the folder was moved or deleted, which open files would hide."""
        if self._place is not None and self._found_place() != self._place:
            raise StoreRefused(
                f"the folder {self.project.folder} was moved or deleted while it was shown",
                hint="end the server, and run: fixel serve --project FOLDER",
            )
        return self

    @property
    def folder(self) -> Path:
        """Absolute folder of the project, for commands that are typed elsewhere."""
        return self.project.folder.resolve()

    def calibration_detail(self, number: int) -> StoredCalibration:
        """Return everything about a stored calibration, and remember some: what is stored stays."""
        found = self._details(number)
        if not found.complete:
            self._details.cache_clear()  # its experiments may be restored
        return found

    def close(self) -> None:
        """End the campaign of the bench, and close the store."""
        self.bench.close()
        self.store.close()


def _context(request: Request) -> ProjectContext:
    context: ProjectContext = request.app.state.context
    return context.here


# Parameter of a route that needs the project.
Context = Annotated[ProjectContext, Depends(_context)]
