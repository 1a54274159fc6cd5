import json
import math
import pickle
import zlib
from pathlib import Path

import pytest

from fixel.cli.main import _exit
from fixel.errors import (
    DatasetMissing,
    DeviceFailed,
    FixelError,
    InvalidInput,
    SolveFailed,
    number_of,
    reason_of,
    unknown_name,
)
from fixel.web.problems import problem_of

ERRORS = [
    InvalidInput(
        "bodies[0].mass", found=-1.0, expected="a positive number", hint="give it in kilograms"
    ),
    InvalidInput("the scene is empty"),
    SolveFailed("the pusher is jammed", status="jammed", stopped_at=1.25),
    DatasetMissing("pushes", expected="an inputs.csv", hint="set FIXEL_DATA"),
    DeviceFailed("a limit switch was hit", hint="home the drive"),
]


def test_invalid_input_says_what_was_found_and_expected_in_one_sentence() -> None:
    error = InvalidInput("bodies[0].shape.polygon", found="two vertices", expected="at least three")

    assert (
        str(error) == "bodies[0].shape.polygon: found two vertices, but fixel needs at least three"
    )


def test_invalid_input_ends_with_the_next_move() -> None:
    error = InvalidInput(
        "step", found=0.0, expected="a positive number", hint="leave it out to let fixel choose"
    )

    assert str(error).endswith("; leave it out to let fixel choose")


def test_invalid_input_may_be_a_sentence_alone() -> None:
    assert str(InvalidInput("a scene needs a body")) == "a scene needs a body"


def test_none_can_be_what_was_found() -> None:
    assert str(InvalidInput("duration", found=None)) == "duration is missing"


def test_long_values_are_shortened() -> None:
    assert len(str(InvalidInput("at", found=list(range(10_000))))) < 100


@pytest.mark.parametrize(
    ("inner", "outer"), [("mass", "bodies[0].mass"), ("[2].x", "bodies[0][2].x")]
)
def test_within_extends_the_path_outwards(inner: str, outer: str) -> None:
    error = InvalidInput(inner, found=1, expected="2", hint="3").within("bodies[0]")

    assert str(error) == f"{outer} is 1, but must be 2; 3"


def test_dataset_missing_names_the_folder() -> None:
    assert (
        str(ERRORS[3]) == "pushes: found no dataset, but fixel needs an inputs.csv; set FIXEL_DATA"
    )


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_survive_a_trip_between_processes(error: FixelError) -> None:
    copy = pickle.loads(pickle.dumps(error))

    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert {name: repr(value) for name, value in vars(copy).items()} == {
        name: repr(value) for name, value in vars(error).items()
    }


@pytest.mark.parametrize(
    ("kind", "base"),
    [(InvalidInput, ValueError), (SolveFailed, RuntimeError), (DatasetMissing, LookupError)],
)
def test_each_error_is_also_the_builtin_one_expects(kind: type, base: type) -> None:
    assert issubclass(kind, FixelError)
    assert issubclass(kind, base)


def test_an_unknown_name_where_no_name_is_known() -> None:
    assert (
        str(unknown_name("part", "zz", ()))
        == "part is 'zz', but must be a known name; there is none"
    )


def test_unknown_names_are_compared_without_case() -> None:
    error = unknown_name("motion", "Dynamc", iter(("dynamic", "quasistatic")), more=", ...")
    assert error.hint == "did you mean 'dynamic'?"
    assert str(error).startswith("motion is 'Dynamc', but must be one of dynamic, quasistatic, ")
    assert unknown_name("motion", 3, ("dynamic",)).hint is None


def test_control_characters_reach_no_terminal() -> None:
    for error in (InvalidInput("\x1b[2Ja.csv", found="\x9b31m"), DatasetMissing("\x1b[2J\u202e")):
        assert str(error).isprintable()
    assert str(InvalidInput("a\nb", hint="é")) == "a\nb; é"


@pytest.mark.parametrize(
    "text", ["1_0", "\uff11", "\u0661", "nan", "inf", "1e999", "0x10", "", "1,5"]
)
def test_numbers_are_read_in_usual_digits_only(text) -> None:
    with pytest.raises(InvalidInput, match=r"^mass is .*, but must be a number") as caught:
        number_of(text, "mass")
    assert caught.value.found == repr(text)
    assert number_of(" -1.5e3 ", "mass") == -1500.0


@pytest.mark.parametrize(
    ("fail", "reason"),
    [
        (lambda: json.loads("{"), "an error (line 1, column 2)"),
        (lambda: b"\xff".decode(), "characters that are not UTF-8"),
        (lambda: zlib.decompress(b"x"), "damaged, incomplete or foreign content"),
        (lambda: {}["pose"], "damaged, incomplete or foreign content"),
        (lambda: 10.0**400, "numbers out of range"),
        (lambda: Path("/none/such").read_bytes(), "no such file or folder"),
        (lambda: Path("/").read_bytes(), "a folder"),
    ],
)
def test_reasons_have_no_words_of_parsers(fail, reason) -> None:
    with pytest.raises(Exception) as caught:  # noqa: PT011
        fail()
    assert reason_of(caught.value) == reason
    assert InvalidInput("file", found=caught.value).found == reason


def test_a_long_text_of_backslashes_is_an_error_at_once():
    """Texts of strangers are cut before their closing quote; the search for it had no end."""
    found = repr("\\\n" * 400)
    assert len(str(InvalidInput("name", found=found, expected="a name"))) < 400


@pytest.mark.parametrize(("error", "stated"), [
    (InvalidInput("mass"), {"where": "mass"}),
    (InvalidInput("n", found=None, expected="4"), {"where": "n", "expected": "4"}),
    (InvalidInput("n", found=-1.5, hint="lift"), {"where": "n", "found": -1.5, "hint": "lift"}),
    (InvalidInput("n", found=3, expected="4"), {"where": "n", "found": 3, "expected": "4"}),
    (InvalidInput("n", found="'x'", expected="4"), {"where": "n", "found": "'x'", "expected": "4"}),
    (InvalidInput("n", found=math.nan), {"where": "n", "found": "nan"}),
    (InvalidInput("n", found=[1, 2]), {"where": "n", "found": "[1, 2]"}),
])  # fmt: skip
def test_commands_and_the_interface_state_the_same_of_an_error(error, stated, capsys):
    with pytest.raises(SystemExit):
        _exit(2, error, as_json=True)
    printed = json.loads(capsys.readouterr().out)["error"]
    assert printed == {
        "kind": "InvalidInput", "sentence": str(error), "exit_code": 2, **stated
    }  # fmt: skip
    answered = json.loads(problem_of(error).model_dump_json(exclude_none=True))
    assert answered == {"status": 422, "sentence": str(error), **stated}
