"""A project of simulated runs, made once; a server of a copy of it; a real browser."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.fixtures import project_of

from fixel.database.project import Project
from fixel.model import Flag
from fixel.sampling import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed

NAMES = (os.environ.get("CHROMIUM"), "chromium", "chromium-browser", "google-chrome")
QUIET = [
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-quic",
    "--no-first-run",
    "--disable-features=OptimizationHints,MediaRouter",
    "--disable-dev-shm-usage",
    "--disable-gpu",
]
SCRIPTS = ["<img src=x onerror=window.hacked=1>", "</script><script>window.hacked=1</script>"]


@pytest.fixture(scope="session")
def laboratory(tmp_path_factory) -> Path:
    """A project folder with 30 experiments of two shapes and some layouts; not to be changed."""
    folder = tmp_path_factory.mktemp("laboratory") / "my_lab"
    project = project_of(folder, SimulatedTestbed(seed=1).run(thesis_plan().experiments[::14]))
    with project.store() as store:
        store.flag([3], Flag("misregistered", "starts 4.2 mm inside the pusher"))
        store.flag([5], Flag("late", "by 0.2 s", fault=False))
        _simulate(store, [1, 2, 3])
    return folder


def _simulate(store, numbers):
    """Stored simulations with nominal values, as `fixel compare --save` keeps them."""
    from fixel.workflows.project.compare import compare_run

    for number in numbers:
        answer = compare_run(store.experiment(number))
        store.add_simulation(answer.record(number, "fixel compare --save"))


@pytest.fixture(scope="session")
def trusted_laboratory(laboratory, tmp_path_factory) -> Path:
    """The same with a calibration of six experiments and a map of all; not to be changed."""
    from tests import calibrating as run

    from fixel.web.views.calibration_form import CalibrationForm
    from fixel.workflows.domain.request import DomainRequest
    from fixel.workflows.domain.run import map_stored

    folder = tmp_path_factory.mktemp("trusted") / "my_lab"
    shutil.copytree(laboratory, folder)
    form = CalibrationForm(
        name="first",
        experiments=range(6, 12),
        unknowns=[
            {"name": "mu_pusher", "low": 0.0, "high": 1.0, "start": 0.2},
            {"name": "tripod_radius", "low": 0.001, "high": 0.0755, "start": 0.0409},
        ],
        optimiser="nelder-mead",
        most_evaluations=60,
        starts=2,
    )
    project = Project(folder)
    with project.store() as store:
        chosen = form.selection(store)
    job = run.prepare(project, chosen, form.plan(chosen).request)
    run.run(job)
    run.collect(project, job, "fixel calibrate --name first", {})
    asked = DomainRequest(axes=("offset_y_m", "shape"), fit=("mu_pusher",), folds=2, threshold=6.0)
    map_stored(project, asked, command="fixel domain")
    return folder


@pytest.fixture(scope="module")
def project(laboratory, tmp_path_factory) -> Path:
    """A copy of the laboratory for the tests of one module, which may change it."""
    folder = tmp_path_factory.mktemp("copy") / "my_lab"
    shutil.copytree(laboratory, folder)
    return folder


@pytest.fixture(scope="module")
def server(project):
    """The pages of the copy, on a port of this machine: `server.link`, `server.home`."""
    from fixel.web.context import ProjectContext
    from fixel.web.project import project_server

    context = ProjectContext(Project(project))
    running = project_server(context).start()
    running.context = context
    yield running
    running.stop()
    context.close()


@pytest.fixture(scope="module")
def chromium():
    """One browser for a module; longer, and its event loop would be in the way of others."""
    found = next((path for name in NAMES if name and (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium on this machine")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=found, chromium_sandbox=os.geteuid() != 0, args=QUIET
        )
        yield browser
        browser.close()


@pytest.fixture
def browser_page(chromium, server):
    """A page that has opened the link; every error in it fails the test."""
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.set_default_timeout(5000)
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda line: problems.append(line.text) if line.type == "error" else None)
    page.expected_problems = []
    page.goto(server.link)
    yield page
    context.close()
    surprises = [p for p in problems if not any(e in p for e in page.expected_problems)]
    assert surprises == []


def unpacked(array):
    """The numbers of a packed array."""
    import base64

    data = base64.b64decode(array["base64"])
    return np.frombuffer(data, array["dtype"]).reshape(array["shape"])
