"""Files of trials: round trip, damage, crashes, and files of something else."""

import pytest
from tests.fixtures import refused

from fixel.formats.trials_file import append_trials, read_trials, write_trials
from fixel.planning.trials import PlanTrial, Trials

NOW = "2026-11-22T21:00:00+00:00"
NONE = Trials(plan="a1", stated=0.9, mean=0.95)
TRIALS = (
    PlanTrial(NOW, True, start=(0.1, 0.2, -0.3), end=(1.0 / 3.0, 1e-300, 3.0), by="operator, left"),
    PlanTrial(NOW, False, 'slid "off"', start=(0.1, 0.2, -0.3)),
    PlanTrial(NOW, False),
)


def written(path):
    write_trials(path, NONE)
    append_trials(path, TRIALS[0], plan="a1")
    append_trials(path, *TRIALS[1:], plan="a1")
    return path


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "trials.csv")


def test_trials_are_read_as_they_were_appended(path, tmp_path):
    assert read_trials(path) == NONE.added(*TRIALS)
    assert read_trials(write_trials(tmp_path / "b.csv", read_trials(path))) == read_trials(path)


def test_any_cut_loses_at_most_the_row_that_was_being_written(path):
    whole = path.read_bytes()
    first = whole.index(b"\n", whole.index(b"trial,")) + 1
    for length in range(first, len(whole)):
        path.write_bytes(whole[:length])
        found = read_trials(path)
        assert found == NONE.added(*TRIALS[: whole[first:length].count(b"\n")])
    assert append_trials(path, TRIALS[2]) == NONE.added(*TRIALS)
    assert path.read_bytes() == whole


@pytest.mark.parametrize(("old", "new", "where"), [
    ("\n2,", "\n3,", "line 4"),
    (",no,", ",maybe,", "line 4"),
    ("0.1,0.2", "0.1,x", "line 3"),
    ("0.1,0.2", "0.1,nan", "line 3"),
    ("0.1,0.2", "0.1", "line 3"),
    ("2026", "then", "line 3"),
    ("trial,time", "trial,when", "line 2"),
    ('"stated": 0.9', '"stated": 1.9', "line 1"),
    ('"stated": 0.9', '"stated": "high"', "line 1"),
    ('"trials"', '"plan"', "line 1"),
    ('"format": 1', '"format": 2', "format 2"),
    ('"plan": "a1"', '"plan": "b2"', "plan b2"),
])  # fmt: skip
def test_damaged_and_foreign_files_are_rejected_by_line(path, old, new, where):
    path.write_text(path.read_text().replace(old, new, 1))
    before = path.read_bytes()
    refused(read_trials, path, plan="a1", match=where)
    refused(append_trials, path, TRIALS[0], plan="a1", match=where)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "content", [b"", b"a\x00b", b"\xff\xfe\n", b"x,y\n1,2\n", b"# {}\n", b"# []\n"]
)
def test_other_files_are_rejected(tmp_path, content):
    path = tmp_path / "other.csv"
    path.write_bytes(content)
    refused(read_trials, path)


def test_missing_files_and_stated_probabilities_are_not_replaced(path, tmp_path):
    refused(read_trials, tmp_path / "none.csv", match="no such file")
    refused(write_trials, path, NONE, match="existing file")
