"""One grammar of filters: SQL and memory select the same experiments."""

import numpy as np
import pytest
from tests.database.records import simulation
from tests.fixtures import refused

from fixel.database.project import Project
from fixel.database.query import ALL_EXPERIMENTS
from fixel.errors import InvalidInput
from fixel.model import Experiment, Flag, Provenance, Trajectory
from fixel.model.selection import KnownNames, holds, meant_filter, parse_filter, refuse_unknown
from fixel.workflows.experiments import read_experiments

ORIGIN = Provenance(version="0")
NAMES = ("surface", "layout", "speed_m_s", "error", "moved", "turned", "x", "duration", "frames")
VALUES = ("abs", "plywood", "3", "3.0", "007", "0.02", "-1", "2", "40", "abc def")


def random_experiment(rng, number):
    conditions = {
        "surface": str(rng.choice(["abs", "plywood", "3", "007"])),
        "layout": rng.choice([1.0, 3.0, 0.02]).item(),
        "speed_m_s": rng.choice([0.02, 3.0, 40.0]).item(),
    }
    kept = {name: value for name, value in conditions.items() if rng.random() < 0.7}
    flags = [Flag("late", "by 0.2 s"), Flag("no-angle", "Plywood", fault=False)]
    n = int(rng.integers(2, 4))
    return Experiment(
        dataset=str(rng.choice(["abs", "mit"])),
        name=f"push_{number:02d}%",
        real=bool(real := rng.random() < 0.5),
        simulated_by="" if real else "test",
        provenance=ORIGIN,
        trajectory=Trajectory(
            time=np.arange(n) * rng.choice([1.0, 2.0]),
            pose=np.round(rng.uniform(-0.05, 0.05, (n, 3)) * [1, 1, 60], 3),
        ),
        conditions=kept,
        flags=tuple(flag for flag in flags if rng.random() < 0.3),
    )


@pytest.fixture
def filled(store):
    rng = np.random.default_rng(5)
    for number in range(40):
        added = store.add_experiment(random_experiment(rng, number))
        if rng.random() < 0.5:
            store.add_simulation(simulation(added.id, float(rng.choice([4.0, 9.0, 1600.0]))))
    store.annotate([3, 5, 7], "slipped on Plywood")
    return store


def random_filter(rng):
    terms = []
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(0, 5)
        if kind <= 2:
            name, relation = rng.choice(NAMES), rng.choice(["=", "!=", "<", "<=", ">", ">="])
            terms.append(f'{name}{relation}"{rng.choice(VALUES)}"')
        elif kind == 3:
            marks = ["real", "simulated", "clean", "faulty", "flagged", "is:noted", "flag:late"]
            terms.append(str(rng.choice(marks)))
        else:
            terms.append(str(rng.choice(["plywood", "PUSH_1", "abs", "%", "late", "dataset:mit"])))
    return " ".join(terms)


def test_sql_and_memory_select_the_same(filled):
    page = filled.experiments(ALL_EXPERIMENTS, details=True)
    rng, matched = np.random.default_rng(6), 0
    for _ in range(300):
        text = random_filter(rng)
        try:
            query = parse_filter(text, include_faulty=bool(rng.random() < 0.5))
        except InvalidInput:
            continue
        in_memory = [
            row.id
            for row, details in zip(page.rows, page.details, strict=True)
            if holds(query, row, details)
        ]
        assert sorted(filled.experiment_ids(query)) == in_memory, text
        assert parse_filter(query.filter, include_faulty=query.include_faulty) == query
        matched += 0 < len(in_memory) < 40
    assert matched > 60


def test_texts_equal_numbers_typed_like_them(filled):
    """`layout` 3.0 and `surface` "3" are both 3; unequal is whatever is not equal."""
    all_ids = filled.experiment_ids(ALL_EXPERIMENTS)
    for text in ("surface=3", "layout=3", "surface=007", "speed_m_s=0.02"):
        same = filled.experiment_ids(parse_filter(text, include_faulty=True))
        other = filled.experiment_ids(parse_filter(text.replace("=", "!="), include_faulty=True))
        assert same
        assert sorted(same + other) == all_ids


@pytest.mark.parametrize(("text", "complaint"), [
    ("error>large", "filter: error is 'large', but must be a number"),
    ("speed_m_s>fast", "filter: speed_m_s is 'fast', but must be a number"),
    ("is:reel", "one of clean, faulty"),
    ('surface="abs', "a quote that does not end"),
    ("x" * 1001, "1001 characters"),
])  # fmt: skip
def test_filters_without_a_meaning_are_refused(text, complaint):
    refused(parse_filter, text, match=complaint)


def test_terms():
    query = parse_filter('surface = "plain wood" real moved<80', dataset="mit", limit=3)
    assert [bound[:3] for bound in query.bounds] == [
        ("surface", "=", "plain wood"),
        ("moved_m", "<", 0.08),
    ]
    assert (query.marks, query.dataset, query.limit) == (("real",), "mit", 3)


def test_a_text_is_not_compared_with_a_number(tmp_path):
    """Columns without a unit are texts; `mass>0.6` silently selected nothing."""
    table = {"time_s": [0.0, 1.0] * 2, "x_mm": [0.0, 9.0] * 2, "y_mm": [0.0] * 4}
    table |= {"push": ["1", "1", "2", "2"], "mass": ["0.5", "0.5", "0.9", "0.9"]}
    table |= {"speed_mm_s": [10.0, 10.0, 20.0, 20.0]}
    pushes = read_experiments(table, split_by="push")
    project = Project.create(tmp_path / "lab")
    project.add(pushes)
    for chosen in (pushes.where, project.experiments):
        refused(chosen, "mass>0.6", match="mass: found texts, but fixel needs numbers")
        assert [one.name for one in chosen("mass=0.9")] == ["2"]
        assert [one.name for one in chosen("speed_m_s>0.015")] == ["2"]
        assert len(chosen("speed_m_s>1")) == 0


def test_unknown_names_have_suggestions():
    known = KnownNames(["mit"], ["late"], {"surface": ["abs", "plywood"]})
    for text, found, meant in (
        ("surfce!=abs", True, "surface"),
        ("surface=plywod", False, "plywood"),
        ("flag:lat", False, "late"),
        ("dataset:mitt", False, "mit"),
    ):
        with pytest.raises(InvalidInput, match=f"did you mean '{meant}'"):
            refuse_unknown(parse_filter(text), known, found=found)
    refuse_unknown(parse_filter("surface=plywod"), known, found=True)
    assert meant_filter("surfce=abs real", known) == "surface=abs real"
    assert meant_filter("surface=abs", known) is None
