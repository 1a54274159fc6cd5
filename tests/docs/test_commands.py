"""The commands that pages show are understood by the command line."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from fixel.cli.main import app

ROOT = Path(__file__).parents[2]
GROUP = typer.main.get_command(app)


def _commands() -> Iterator[tuple[str, list[str]]]:
    """Yield page and words of each command of fixel in a block of a page."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        place = page.relative_to(ROOT).as_posix()
        if place.startswith(("docs/reference/commands", "docs/project", "docs/decisions")):
            continue
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"^(?: {4}|\$ )(?:\.venv/bin/)?(fixel .*)$", text, re.MULTILINE):
            for command in re.split(r" (?:&&|\||;|>) ", line):
                words = shlex.split(command.replace("...", ""), comments=True)
                if words[0] == "fixel":
                    yield place, words[1:]


COMMANDS = list(_commands())


@pytest.mark.parametrize("page", sorted({page for page, _ in COMMANDS}))
def test_commands_of_a_page_are_understood(page: str) -> None:
    for words in (words for place, words in COMMANDS if place == page):
        command, k = GROUP, 0
        while k < len(words) and words[k] in getattr(command, "commands", {}):
            command, k = command.commands[words[k]], k + 1
        assert k or words == ["--version"], f"no such command: fixel {' '.join(words)}"
        try:
            command.make_context(" ".join(["fixel", *words[:k]]), words[k:])
        except typer.BadParameter as error:
            if "does not exist" not in error.message:  # a file of the reader
                raise
