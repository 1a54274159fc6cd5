"""The report: whole, offline, escaped, in a real browser; and what it warns of."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests import calibrating as run
from tests.fixtures import project_of
from tests.web.conftest import chromium  # noqa: F401

import fixel
from fixel.database.project import Project
from fixel.drawing.calibration import seconds_chart
from fixel.errors import InvalidInput
from fixel.model.records import Estimate
from fixel.sampling.published import thesis_plan
from fixel.table import Table
from fixel.testbed.simulated import SimulatedTestbed
from fixel.testing.scenes import pushed_square
from fixel.workflows.analysis import Analysis, Picture, store_analysis
from fixel.workflows.calibration.stored import load_values, stored_calibration
from fixel.workflows.report.sections import calibration_warnings
from fixel.workflows.report.write import bibtex, known_works, line, works

PLANNED = thesis_plan().experiments
EVIL = '<script>alert("x")</script>'


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project with four experiments, one of a strange name, and a calibration of all of them."""
    experiments = list(SimulatedTestbed.ideal().run([PLANNED[k] for k in (0, 1, 2, 7)]))
    experiments[3] = replace(experiments[3], name=EVIL)
    fit = ["mu_pusher", "tripod_radius_mm=10:60:30"]
    command = "fixel calibrate --mode joint"
    folder = tmp_path_factory.mktemp("report") / "lab"
    return run.calibrated(folder, experiments, fit, command, mode="joint")


@pytest.fixture(scope="module")
def report(project, tmp_path_factory):
    return project.report(tmp_path_factory.mktemp("out") / "r", command="fixel report")


@pytest.fixture
def without_charts(monkeypatch):
    """Reports of this test have no charts of the calibration, which take seconds each time."""
    monkeypatch.setattr("fixel.workflows.report.sections.pictures_of", lambda *_: [])


def _kept(project, **changes):
    with project.store() as store:
        number = load_values(store).id
    chart = seconds_chart(keys=("a", "b"), seconds=np.array([0.1, 0.2]), evaluations=(1, 2))
    analysis = Analysis(
        kind="domain",
        title="Map",
        question={"tau_mm": 2.0},
        headline=("Trusted at 2 mm in 3 of 4 cells.",),
        warnings=("One cell has no data.",),
        tables=(Table(("cell", "error [mm]"), ((EVIL, "1.0"),), title="Cells"),),
        methods=("Cells were judged by cross-validation.",),
        references=("vovk2005",),
        calibrations=(number,),
        command="fixel domain",
    )
    return store_analysis(
        project, analysis.model_copy(update=changes), [Picture("map", chart, "", "A map.")]
    )


class _Page(HTMLParser):
    """Every tag with what it points to, and all text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.links = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href", "action", "srcset", "data")]

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_needs_nothing_but_itself(report):
    text = report.page.read_text(encoding="utf-8")
    page = _Page(text)
    assert page.links
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)
    assert "script" not in page.tags
    assert "url(" not in text
    assert len(text.encode()) == report.size < 10_000_000
    anchors = set(re.findall(r'id="([^"]+)"', text))
    assert {link[1:] for link in page.links if link.startswith("#")} <= anchors


def test_the_first_page_names_command_and_version(report):
    facts = dict(report.content.facts)
    assert facts["command"].startswith("fixel calibrate ")
    assert not any(
        value.startswith("fixel calibrate") for name, value in facts.items() if "version" in name
    )


def test_names_of_experiments_are_text_and_no_markup(project, report, without_charts):
    assert EVIL not in report.page.read_text(encoding="utf-8")
    _kept(project)
    again = project.report(report.page.parent.parent / "evil")
    assert EVIL in "".join(_Page(again.page.read_text(encoding="utf-8")).text)


def test_warnings_stand_first_and_name_the_next_command(report):
    text = report.page.read_text(encoding="utf-8")
    assert text.index('id="warnings"') < text.index('id="findings"')
    words = " ".join(report.content.warnings)
    assert "simulated" in words
    for command in ("fixel domain", "fixel sensitivity", "fixel uncertainty"):
        assert command in words
    assert "SIMULATED" in report.content.banner


def test_an_analysis_takes_its_place_and_its_warnings(project, tmp_path, without_charts):
    _kept(project)
    done = project.report(tmp_path / "r")
    words = " ".join(done.content.warnings)
    assert "One cell has no data." in words
    assert "fixel domain" not in words
    assert "Trusted at 2 mm in 3 of 4 cells." in done.content.findings
    assert any(path.name == "domain_map.pdf" for path in done.figures)
    assert "vovk2005" in done.bibliography.read_text(encoding="utf-8")
    assert "Cells were judged by cross-validation." in done.page.read_text(encoding="utf-8")


def test_an_analysis_of_another_calibration_has_no_place(project, tmp_path, without_charts):
    _kept(project, question={"of": "another"}, calibrations=(999,), experiments=(998,), title="No")
    titles = [s.title for s in project.report(tmp_path / "r").content.sections]
    assert titles.count("Domain of applicability") <= 1


def test_figures_are_there_as_pdf_and_sizes_in_json(report):
    assert len(report.figures) >= 4
    for path in report.figures:
        assert path.read_bytes().startswith(b"%PDF")
        assert path.with_suffix(".csv").is_file()
    assert json.loads(json.dumps(report.summary()))["bytes"] == report.size


def test_numbers_of_the_calibration_are_those_stored(project, report):
    with project.store() as store:
        errors = [member.error_mm2 for member in load_values(store).record.members]
    table = next(t for s in report.content.sections for t in s.tables if "Root mean" in t.title)
    assert table.rows[-1][0] == "calibrated"
    assert table.rows[-1][1] == pytest.approx(np.sqrt(errors).mean(), rel=5e-3)


def test_a_report_on_single_calibrations_lists_all_of_the_run(tmp_path, without_charts):
    pushes = fixel.datasets.example()[:3]
    lab = project_of(tmp_path / "lab", pushes)
    fits = fixel.calibrate_each(pushes, {"mu_pusher": (0, 1)}, verdicts=False, progress=False)
    lab.add(fits)
    errors = next(part for part in lab.report(tmp_path / "r").content.sections
                  if part.anchor == "errors")  # fmt: skip
    assert "The run has 3 calibrations." in " ".join(errors.lead)
    (table,) = (one for one in errors.tables if one.title == "Calibrations of the run")
    assert [row[0] for row in table.rows] == [
        key for one in fits for key in one.keys_of_experiments
    ]


def test_findings_of_results_are_words(tmp_path):
    runs = fixel.simulate_batch(pushed_square(), {"mu_pusher": [0.2, 0.3]}, duration=0.1)
    content = fixel.report(runs, tmp_path / "r").content
    assert content.title == "Batch result"
    assert content.findings[0].startswith("Batch result: 2 runs")


def test_verdicts_become_warnings(project):
    fit = stored_calibration(project, 1)
    verdicts = ("not identified", "at bound", "trades off with mu_pusher", "identified")
    estimates = tuple(
        Estimate(label=f"p{k}", unit="-", value=1.0, verdict=verdict)
        for k, verdict in enumerate(verdicts)
    )
    outcome = replace(fit.run.outcome, found=(replace(fit.found, estimates=estimates),))
    words = calibration_warnings(replace(fit, run=replace(fit.run, outcome=outcome), number=0))
    assert [any(word.startswith(f"p{k} ") for word in words) for k in range(4)] == [
        True,
        True,
        True,
        False,
    ]


def test_without_a_calibration_there_is_nothing_to_report(tmp_path):
    with pytest.raises(InvalidInput, match="fixel calibrate"):
        Project.create(tmp_path / "empty").report(tmp_path / "r")


def test_the_bibliography_is_bibtex():
    text = bibtex(works([*known_works(), "nobody1900"]))
    entries = re.findall(r"@\w+\{(\w+),", text)
    assert entries == [*known_works()]
    assert entries[0] == "fixel"
    assert text.count("{") == text.count("}")


def test_every_work_that_is_cited_is_known():
    """Keys in the sources look like a name and a year."""
    folder = Path(fixel.__file__).parent / "workflows"
    cited = {
        key
        for path in folder.rglob("*.py")
        for key in re.findall(r'"([a-z]+(?:19|20)\d\d)"', path.read_text(encoding="utf-8"))
    }
    assert "speagle2020" in cited
    assert cited <= set(known_works())


@pytest.mark.system
def test_a_real_browser_shows_and_prints_it(report, chromium, tmp_path):  # noqa: F811
    shot, printed = tmp_path / "shot.png", tmp_path / "page.pdf"
    page = chromium.new_page(viewport={"width": 1000, "height": 1400})
    page.goto(report.page.as_uri())
    page.screenshot(path=shot)
    page.pdf(path=printed)
    page.close()
    with Image.open(shot) as image:
        pixels = np.asarray(image.convert("RGB"))
    # The band over simulated data, and text below it.
    band = (pixels == [213, 94, 0]).all(axis=2)
    assert band[:60].mean() > 0.3
    assert (pixels.max(axis=2) < 90).mean() > 0.005
    assert printed.read_bytes().startswith(b"%PDF")
    assert printed.stat().st_size > 50_000


def test_the_two_sources_are_cited_with_their_titles():
    """Titles and authors as on the title pages, where a description in brackets stood before."""
    cited = works(["rpi2011", "asme2006"])
    thesis, paper = line(cited["rpi2011"]), line(cited["asme2006"])
    assert thesis.startswith("Macaluso, W. (2012). Exploring the domain of applicability")
    assert paper.startswith("Cappelleri, D. J., Fink, J. et al. (2006). Modeling uncertainty")
    assert "DETC2006-99687" in paper
    assert not any("title = {{[" in entry for entry in known_works().values())
    assert "@mastersthesis{rpi2011," in bibtex(cited)
