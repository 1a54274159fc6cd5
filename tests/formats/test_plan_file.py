"""Plan files: what is written reads back, and what is wrong is refused with the path of its key."""

import copy
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from tests.fixtures import refused

from fixel import Disk, Ellipsoid, InvalidInput, NoSupport, Polygon, UniformPressure
from fixel.formats.plan_file import PlanRecord, load_plan, plan_text
from fixel.sampling import Grid, Nominal, OffsetList, OffsetSample, thesis_plan

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "sampling.md"


def content():
    return copy.deepcopy(yaml.safe_load(plan_text(thesis_plan())))


def variety():
    """A plan with every form there is."""
    square, pentagon = thesis_plan().shapes
    triangle = Polygon([[0.0, 0.0], [0.1, 0.0], [0.0, 0.07]])
    return replace(
        thesis_plan(),
        name="1e3",  # as text
        rig=replace(thesis_plan().rig, head=Disk(0.01), force_limit=None),
        shapes=(
            replace(square, name="no", support=UniformPressure(friction=0.1, n_points=32)),
            replace(pentagon, outline=triangle, support=NoSupport()),
            replace(pentagon, name="0x1F", outline=Disk(0.05)),
        ),
        schemes=(
            Nominal(),
            Grid(x=(0.0, 0.01), theta=(0.1, 1 / 3)),
            OffsetList(((1e-3, 2e-3, 1e-17),)),
            OffsetSample(method="halton", count=5, seed=3, y=(-0.01, 0.01)),
        ),
        repetitions=3,
    )


@pytest.mark.parametrize("plan", [thesis_plan(), variety()], ids=["thesis", "variety"])
def test_what_is_written_reads_back(plan, tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text(plan_text(plan), encoding="utf-8")
    again = load_plan(path)
    assert again == plan
    assert again.experiments == plan.experiments


def test_the_thesis_is_a_small_file():
    assert len(plan_text(thesis_plan())) < 3000


def test_json_is_read_too(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(content()), encoding="utf-8")
    assert load_plan(path) == thesis_plan()


@pytest.fixture
def file(tmp_path):
    """Function that writes a text to a file, and returns its path."""

    def write(text):
        path = tmp_path / "plan.yaml"
        path.write_text(text)
        return path

    return write


WRONG = [
    (("head", "speed"), -1.0, r"^head\.speed is -1\.0, .*than 0 \(speed of the head \[m/s\]\)"),
    (("head", "speed"), "fast", r"^head\.speed is 'fast', but must be a number"),
    (("head", "speed"), float("nan"), r"^head\.speed"),
    (("head", "shape"), {}, r"^head\.shape is missing: give exactly one of polygon"),
    (
        ("head", "shape"),
        {"disk": 1.0, "polygon": []},
        "polygon and disk, but fixel needs exactly one",
    ),
    (("head", "shape"), {"polygon": []}, r"^head\.shape\.polygon"),
    (("shapes", 0, "mass"), 0, r"^shapes\[0\]\.mass"),
    (("shapes", 0, "masss"), 1.0, r"^shapes\[0\]\.masss: found an unknown key.*mean 'mass'\?"),
    (("shapes",), [], "^shapes: found none"),
    (("shapes", 1, "name"), "../up", r"^shapes\[1\]\.name is '\.\./up'"),
    (("shapes", 1, "name"), "square", r"^shapes\[1\]\.name: found 'square' twice"),
    (("shapes", 0, "shape"), {"regular": {"sides": 10**9, "side": 1.0}}, r"regular\.sides"),
    (("layouts", 3, "pegs"), [[0.5, 2.0]], r"^layouts\[3\]\.pegs\[0\]"),
    (("layouts", 3, "pegs"), [[0.5]], r"^layouts\[3\]\.pegs\[0\]"),
    (("offsets", 1, "axis", "name"), "z", r"^offsets\[1\]\.axis\.name is 'z'"),
    (("offsets", 1, "axis", "last"), 10**12, r"^offsets\[1\]\.axis\.last"),
    (("offsets", 0), {"sample": {"count": 10**15}}, r"^offsets\[0\]\.sample: .*at most 100000"),
    (("offsets", 0), {"grid": {"x": []}}, r"^offsets\[0\]\.grid\.x"),
    (("offsets",), "nominal", r"^offsets is 'nominal'"),
    (("repetitions",), 10**9, "^plan: found 420000000000 experiments"),
    (("repetitions",), 1.5, "^repetitions"),
    (("repetitions",), True, "^repetitions"),
    (("fixel_plan",), 2, "^fixel_plan is 2, but must be 1"),
]


@pytest.mark.parametrize(("path", "value", "sentence"), WRONG)
def test_what_is_wrong_is_refused_with_its_path(path, value, sentence, file):
    raw = content()
    level = raw
    for key in path[:-1]:
        level = level[key]
    level[path[-1]] = value
    path = file(yaml.safe_dump(raw))
    before, _, rest = str(refused(load_plan, path)).partition(f"{path}: ")
    assert not before
    assert re.search(sentence, rest)


@pytest.mark.parametrize("text", ["", "[]", "a", "{fixel_plan: 1}", "a: &x 1\nb: *x", "!!set {a}"])
def test_what_is_no_plan_is_refused(text, file):
    refused(load_plan, file(text))


def test_a_missing_key_is_named(file):
    raw = content()
    del raw["nominal"]["gap"]
    refused(load_plan, file(yaml.safe_dump(raw)), match=r"plan\.yaml: nominal\.gap is missing")


def test_a_support_that_a_file_cannot_hold_is_refused():
    square = thesis_plan().shapes[0]
    ellipsoid = Ellipsoid(force=1.0, torque=0.03)
    with pytest.raises(InvalidInput, match="the supports of plan files"):
        plan_text(replace(thesis_plan(), shapes=(replace(square, support=ellipsoid),)))


def test_the_page_names_every_key_and_its_example_loads(file):
    page = PAGE.read_text(encoding="utf-8")
    schema = PlanRecord.model_json_schema()
    records = [schema, *schema["$defs"].values()]
    keys = {key for record in records for key in record.get("properties", {})}
    named = set(re.findall(r"`([a-z_]+)`", page)) | set(re.findall(r"([a-z_]+):", page))
    assert keys <= named, f"undocumented: {sorted(keys - named)}"
    plan = load_plan(file(re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)[0]))
    assert plan.check() == ()
    assert len(plan.experiments) == 74
