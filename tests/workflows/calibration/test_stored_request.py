"""Stored calibrations state all options and results of their run, wherever they are read."""

import dataclasses
import hashlib
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from tests.fixtures import project_of, refused

import fixel
from fixel.cli.main import run as run_command
from fixel.database.bundle import export_bundle, import_bundle
from fixel.database.project import Project
from fixel.database.rows import lost
from fixel.database.store import Store
from fixel.errors import StoreRefused
from fixel.model.records import CalibrationRecord
from fixel.model.space import Unknown
from fixel.sampling.published import thesis_plan
from fixel.testbed.simulated import SimulatedTestbed
from fixel.web.views.calibration_views import load_detail
from fixel.workflows.calibration.request import CalibrationRequest, NamedOptions, command_of
from fixel.workflows.calibration.stored import RUN, add_to_project, stored_calibration
from fixel.workflows.report.write import report

# Every option of a request, unlike its default.
UNLIKE = {
    "name": "other",
    "mode": "campaign",
    "unknowns": [
        Unknown(name="mu_pusher", low=0.1, high=0.9, nominal=0.3, scale=0.02, prior=0.05),
        Unknown.fixed("tripod_radius", 0.03),
    ],
    "error": NamedOptions(name="robust", options={"angle_scale": 0.02, "distance": 0.003}),
    "motion": "quasistatic",
    "optimiser": NamedOptions(name="pattern-search", options={"threshold_delta": 0.05}),
    "starts": 3,
    "combine": "mean",
    "seed": 7,
    "noise_position": 2e-4,
    "noise_angle": 3e-3,
    "level": 0.5,
    "verdicts": False,
    "stored": [[0.1], [0.3]],
    "budget": 12.5,
    "sample_of": 40,
    "max_evaluations": 9,
}


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    planned = [thesis_plan().experiments[k] for k in (0, 1)]
    folder = tmp_path_factory.mktemp("stored") / "lab"
    return project_of(folder, SimulatedTestbed(seed=3).run(planned))


@pytest.fixture(scope="module")
def fit(project):
    """A calibration with options unlike their defaults; not to be changed."""
    return fixel.calibrate(
        project.experiments(),
        {"mu_pusher": fixel.Parameter(0.05, 0.95, start=0.3), "tripod_radius": 0.03},
        error={"name": "mean-square", "angle_scale": 0.02},
        optimiser={"name": "pattern-search", "threshold_delta": 0.02},
        starts=2,
        combine="mean",
        seed=5,
        noise=fixel.Noise(position_m=2e-4, angle_rad=3e-3),
        level=0.5,
        motion="quasistatic",
        max_evaluations=40,
        name="unlike",
        store=project,
        progress=False,
        threads=1,
    )


def texts(folder, number, capsys):
    """Everything that a user reads of a stored calibration, without the place of the project."""
    project = Project(folder)
    with pytest.raises(SystemExit) as end:
        run_command(["calibrations", str(number), "-p", str(folder)])
    assert not end.value.code
    with project.store() as store:
        page = load_detail(project, store, number)
    written = report(project, folder.parent / "report", calibration=number)
    content = written.content
    return {
        "print": repr(stored_calibration(project, number)),
        "html": stored_calibration(project, number)._repr_html_(),
        "command": capsys.readouterr().out,
        "page": page.model_copy(update={"python": ""}).model_dump_json(),
        "report": [content.facts, content.warnings, content.findings, content.methods],
        "tables": [[t.lines() for t in s.tables] + list(s.notes) for s in content.sections],
        "pictures": {path.name: path.with_suffix(".csv").read_text() for path in written.figures},
    }


def test_the_table_covers_every_option():
    usual = CalibrationRequest(unknowns=[])
    assert set(UNLIKE) == set(CalibrationRequest.model_fields)
    assert all(value != getattr(usual, name) for name, value in UNLIKE.items())


def test_the_bytes_of_a_request_stay_since_they_name_folders():
    """The digests are those of requests stored before the fields followed from a signature."""
    usual = CalibrationRequest(unknowns=UNLIKE["unknowns"])
    digests = {
        hashlib.sha256(request.model_dump_json().encode()).hexdigest()[:16]
        for request in (CalibrationRequest(**UNLIKE), usual)
    }
    assert digests == {"6dd7bf800ca478c4", "d5d0ac8f55818955"}


@pytest.mark.parametrize("option", UNLIKE)
def test_every_option_is_stored_and_loaded(option, project, fit):
    request = fit.request.model_copy(update={option: UNLIKE[option]})
    if option == "unknowns":
        outcome = fit.run.outcome
        request = fit.request.model_copy(update={"unknowns": UNLIKE["unknowns"]})
        assert request.space.labels == outcome.labels
    run = add_to_project(project, dataclasses.replace(fit.run, request=request, folder=None))
    found = stored_calibration(project, run.ids[0])
    assert found.request == request
    assert found.call == run[0].call
    assert repr(found) == repr(run[0])


def test_a_stored_calibration_equals_the_computed_one(project, fit):
    assert stored_calibration(project, fit.run.ids[0]) == fit
    by_squares = fixel.calibrate(
        project.experiments(), {"mu_pusher": (0, 1), "tripod_radius": 0.03},
        optimiser="least-squares", verdicts=False, store=project, progress=False, threads=1,
    )  # fmt: skip
    assert stored_calibration(project, by_squares.run.ids[0]) == by_squares


@pytest.mark.system
@pytest.mark.usefixtures("blank")
def test_what_was_printed_is_printed_again(project, fit, tmp_path, capsys):
    number = fit.run.ids[0]
    # A copy, since the folder of the job is deleted on the way.
    folder = tmp_path / "one" / "lab"
    shutil.copytree(project.folder, folder)
    before = texts(folder, number, capsys)
    assert before["print"] == repr(fit)
    assert before["html"] == fit._repr_html_()
    assert "50 % interval" in before["print"]
    assert fit.found.noise in before["html"]
    for words in ("starts=2", "level=0.5", "seed=5", "max_evaluations=40", "quasistatic"):
        assert words in fit.call
    assert before["pictures"]

    program = (
        "import sys; from fixel.workflows.calibration.stored import stored_calibration as load;"
        "import fixel; print(load(fixel.Project(sys.argv[1]), int(sys.argv[2])))"
    )
    command = [sys.executable, "-c", program, str(folder), str(number)]
    again = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert again == before["print"] + "\n"

    shutil.rmtree(folder / "jobs")
    assert texts(folder, number, capsys) == before

    bundle = tmp_path / "lab.zip"
    other = Project.create(tmp_path / "two" / "lab")
    with Project(folder).store() as store, other.store() as target:
        export_bundle(store, bundle)
        import_bundle(bundle, target)
        assert import_bundle(bundle, target)["calibrations"] == 0  # all are known
    assert texts(other.folder, number, capsys) == before


@pytest.mark.usefixtures("blank")
def test_a_campaign_is_whole_without_its_job(project, tmp_path, capsys):
    space = {"mu_pusher": (0, 1), "tripod_radius": 0.03}
    quick = {"name": "pattern-search", "threshold_delta": 0.1}
    with project.store() as store:
        experiments = [store.experiment(k) for k in (1, 2)]
    fits = fixel.calibrate_campaign(
        experiments, space, optimiser=quick, starts=2, verdicts=False, store=project,
        progress=False, threads=1,
    )  # fmt: skip
    number = fits.ids[-1]
    folder = tmp_path / "lab"
    shutil.copytree(project.folder, folder)
    before = texts(folder, number, capsys)
    assert {"calibration_starts.pdf", "calibration_errors.pdf"} <= set(before["pictures"])
    assert len(json.loads(before["page"])["siblings"]) == len(fits)
    shutil.rmtree(folder / "jobs")
    assert texts(folder, number, capsys) == before


def earlier(project, fit):
    """Store a calibration as an earlier version did: without request and result."""
    with project.store() as store:
        record = store.calibration(fit.run.ids[0])
        method = {
            k: v for k, v in record.method.items() if k not in (RUN, "job") and "noise" not in k
        }
        method["unknowns"] = json.dumps([unknown.plain() for unknown in fit.request.unknowns])
        old = dataclasses.replace(record, request=None, result=None, method=method)
        return store.add_calibration(old)


def test_a_record_of_an_earlier_version_states_what_is_unknown(project, fit):
    found = stored_calibration(project, earlier(project, fit))
    text = repr(found)
    assert found.level is None
    assert found.noise is None
    assert "%" not in text.splitlines()[1]
    assert "interval of unknown level" in text.splitlines()[1]
    assert "before" not in text  # the errors of single experiments before were not stored
    assert found.call == ""
    assert found.request.starts == 2
    assert found["mu_pusher"] == fit["mu_pusher"]
    assert {e.level for e in found.estimates.values()} == {None}
    refused(found.samples, 3, match="level")
    with project.store() as store:
        page = load_detail(project, store, found.run.ids[0])
    assert page.level is None
    assert page.noise == ""


def test_options_of_an_earlier_version_repeat_the_command(project, fit):
    with project.store() as store:
        record = store.calibration(fit.run.ids[0])
        asked = dict(record.result["asked"]) | {"faulty": True}
        del asked["flagged"]
        method = {**record.method, RUN: "faulty"}
        result = {**record.result, "asked": asked}
        number = store.add_calibration(dataclasses.replace(record, result=result, method=method))
    assert "--all" in command_of(stored_calibration(project, number).run.asked)


def test_a_new_calibration_needs_a_level(fit):
    refused(fit.request.model_copy(update={"level": None}).check, match="level")


@pytest.mark.parametrize("damage", [
    {"request": {"level": "high"}},
    {"result": {"place": 0}},
    {"result": {"place": 0, "set": {"arrays": {}}, "nominal": [1.0, 1.0]}},
])  # fmt: skip
def test_a_damaged_record_is_a_sentence(project, fit, damage):
    with project.store() as store:
        record = store.calibration(fit.run.ids[0])
        broken = dataclasses.replace(record, **damage, method={**record.method, RUN: "broken"})
        number = store.add_calibration(broken)
    with pytest.raises(StoreRefused, match=f"calibration {number} is damaged"):
        stored_calibration(project, number)


def test_a_lost_file_of_an_experiment_is_no_damage_of_the_calibration(project, fit, monkeypatch):
    def lose(store, experiment_id):
        raise lost(project.folder / "media" / "1f", "is missing")

    monkeypatch.setattr(Store, "experiment", lose)
    with pytest.raises(StoreRefused, match="1f is missing") as refusal:
        stored_calibration(project, fit.run.ids[0])
    assert "damaged" not in str(refusal.value)


def test_records_are_equal_only_with_the_same_request(project, fit):
    with project.store() as store:
        record = store.calibration(fit.run.ids[0])
        again = store.calibration(fit.run.ids[0])
    assert isinstance(record, CalibrationRecord)
    assert record == again
    assert hash(record) == hash(again)
    changed = dict(record.request) | {"level": 0.9}
    assert record != dataclasses.replace(record, request=changed)
    assert np.isfinite(record.result["nominal"]).all()


def test_requests_with_bounds_that_earlier_versions_allowed_are_read():
    plain = CalibrationRequest(**UNLIKE).model_dump(mode="json")
    plain["unknowns"][0] |= {"low": -0.5, "nominal": -0.1}
    found = CalibrationRequest.model_validate_json(json.dumps(plain)).unknowns[0]
    assert (found.low, found.nominal, found.high) == (0.0, 0.0, 0.9)
    refused(Unknown, name="mu_pusher", low=-0.5, high=0.9, nominal=0.3, match="bounds from 0 up")
