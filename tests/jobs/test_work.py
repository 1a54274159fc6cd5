"""The loop that gets rounds answered: once, from the journal or by the engine."""

import json

import pytest
from tests.jobs.kinds import toy_undisturbed

import fixel
from fixel.errors import InvalidInput
from fixel.io.journal import Journal
from fixel.jobs.functions import THREADS, named_function, stamp, threads
from fixel.jobs.work import (
    Chunk,
    Failure,
    LocalEngine,
    Round,
    StopRequest,
    answer_of,
    block_name,
    framed,
    run_work,
    unframed,
)
from fixel.testing.toy_work import FUNCTION, make_toy_work

OPTIONS = {"rounds": 3, "chunks": 5}


@pytest.fixture
def inputs(tmp_path):
    folder = tmp_path / "inputs"
    folder.mkdir()
    (tmp_path / "calls").touch()
    return folder


def run(inputs, stop=None, progress=None, **options):
    with Journal(inputs.parent / "journal") as journal, LocalEngine() as engine:
        work = make_toy_work(inputs, OPTIONS | options)
        return run_work(work, engine, inputs, journal, stop=stop, progress=progress)


def calls(inputs):
    return [line.split()[0] for line in (inputs.parent / "calls").read_text().splitlines()]


def test_every_chunk_is_computed_once_and_the_result_is_the_works(inputs):
    expected, names = toy_undisturbed(inputs, **OPTIONS)
    (inputs.parent / "calls").write_text("")
    assert run(inputs) == expected
    assert len(calls(inputs)) == len(names) == 15


@pytest.mark.parametrize("n_before", range(0, 15, 3))
def test_stopped_anywhere_it_goes_on_to_the_same_bits(inputs, n_before):
    expected, _ = toy_undisturbed(inputs, **OPTIONS)
    (inputs.parent / "calls").write_text("")
    with pytest.raises(StopRequest):
        run(inputs, stop=lambda: len(calls(inputs)) >= n_before)
    assert len(calls(inputs)) == n_before
    assert run(inputs) == expected
    assert sorted(calls(inputs)) == sorted(set(calls(inputs)))


@pytest.mark.parametrize(("changes", "computed"), [({}, 0), ({"sleep_s": 1e-6}, 15)])
def test_a_finished_work_is_answered_from_the_journal_and_another_payload_computed(
    inputs, changes, computed
):
    expected = run(inputs)
    (inputs.parent / "calls").write_text("")
    assert run(inputs, **changes) == expected
    assert len(calls(inputs)) == computed


def test_a_chunk_that_raises_is_an_answer_and_the_rest_goes_on(inputs):
    seen = []
    run(inputs, faulty=["r0-c2"], progress=seen.append)
    assert (seen[-1].done, seen[-1].total, seen[-1].failed) == (15, 15, 1)
    run(inputs, faulty=["r0-c2"], progress=seen.append)
    assert calls(inputs).count("r0-c2") == 1


def test_progress_counts_earlier_sessions_but_does_not_count_them_as_speed(inputs):
    run(inputs)
    seen = []
    run(inputs, progress=seen.append)
    assert [p.done for p in seen] == [5, 10, 15, 15]
    assert seen[-1].note.startswith("best ")
    assert all(p.rate == 0.0 and p.left_s is None for p in seen)


def test_a_name_twice_in_a_round_is_refused(inputs):
    def work():
        yield Round(FUNCTION, [Chunk("a", b""), Chunk("a", b"x")])

    with (
        Journal(inputs.parent / "journal") as journal,
        pytest.raises(InvalidInput, match="found a name twice"),
    ):
        run_work(work(), LocalEngine(), inputs, journal)


def test_answers_survive_the_trip():
    for answer in (b"", b"A\x00", Failure("no such thing: µ")):
        assert unframed(framed(answer)) == answer


def test_a_block_is_of_its_function_and_payload():
    names = {
        block_name(function, Chunk("c", payload))
        for function in ("fixel.a:f", "fixel.a:g")
        for payload in (b"1", b"2")
    }
    assert len(names) == 4


def test_what_a_chunk_function_may_answer(inputs):
    def ends(inputs, payload):
        raise SystemExit(3)

    assert answer_of(lambda inputs, payload: payload, inputs, b"x") == b"x"
    assert "not bytes" in answer_of(lambda inputs, payload: "x", inputs, b"x").reason
    assert answer_of(ends, inputs, b"").reason.startswith("SystemExit: 3 (test_work.py, line")


@pytest.mark.parametrize("name", [
    "os:system",
    "toy:os",
    "toy:MAKER",
    "toy:callable_by_jobs",  # defined elsewhere
    "toy:no_such",
    "toy:evaluate:evaluate",
    "toy",
    "calibration:InvalidInput",
    "../os:system",
    "fixel.testing.toy_work:evaluate",  # a path, not a name
    "fixel.database.rows:fetch",  # public, and not meant for jobs
    "fixel.datasets.reading:plan_import",
    "fixel.jobs.folder:prepare",
    "fixel.cli.main:run",
    "fixel.workflows.domain.work:domain_work",
    "fixel.io.atomic:refuse_unwritable",
    "",
])  # fmt: skip
def test_only_functions_marked_for_jobs_are_called_by_name(name):
    with pytest.raises(InvalidInput, match="function of a job"):
        named_function(name)


def test_a_chunk_function_by_name(inputs):
    assert named_function(FUNCTION).__name__ == "evaluate"


def test_threads_of_a_worker(monkeypatch):
    monkeypatch.delenv(THREADS, raising=False)
    assert threads() is None
    for said, meant in (("4", 4), ("0", None), ("many", None)):
        monkeypatch.setenv(THREADS, said)
        assert threads() == meant


def test_the_stamp_is_of_this_version():
    assert stamp().startswith(f"{fixel.__version__}+")


def growing(inputs, left=None):
    """A work of three rounds of two chunks that does not say how many there are."""
    for k in range(3):
        chunks = [Chunk(f"{k}-{i}", toy_payload(f"{k}-{i}")) for i in range(2)]
        yield Round(FUNCTION, chunks, left=None if left is None else left[k])
    return b"end"


def toy_payload(name):
    given = {"name": name, "x": 0.5, "sleep_s": 0, "compute_s": 0, "poison": [], "faulty": []}
    return json.dumps(given).encode()


def test_a_work_that_may_grow_is_never_shown_as_complete(inputs):
    seen = []
    with Journal(inputs.parent / "journal") as journal, LocalEngine() as engine:
        work = growing(inputs)
        run_work(work, engine, inputs, journal, progress=seen.append)
    assert [one.share for one in seen[:-1]] == [None] * (len(seen) - 1)
    assert [one.left_s for one in seen[:-1]] == [None] * (len(seen) - 1)
    assert seen[-1].share == 1.0


def test_the_share_is_that_of_the_whole_work_and_full_only_at_its_end(inputs):
    seen = []
    with Journal(inputs.parent / "journal") as journal, LocalEngine() as engine:
        work = growing(inputs, left=(4, 2, 0))
        run_work(work, engine, inputs, journal, progress=seen.append)
    by_done = {one.done: one.share for one in seen[:-1]}
    assert by_done[3] == 0.5
    assert max(by_done.values()) < 1.0
    assert seen[-1].share == 1.0
