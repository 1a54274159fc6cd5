"""Files that are complete or absent."""

from pathlib import Path

from fixel.io.atomic import write_whole, written_whole


def test_the_unfinished_file_has_a_name_that_others_cannot_guess(tmp_path: Path) -> None:
    """Two threads write one file, and another user could put a link under a known name."""
    path = tmp_path / "own.csv"
    with written_whole(path) as first:
        first.write_text("first")
        write_whole(path, "second")
        with written_whole(path) as third:
            assert third != first
            assert {first.suffix, third.suffix} == {".csv"}
            third.write_text("third")
    assert path.read_text() == "first"
    assert [*tmp_path.iterdir()] == [path]
