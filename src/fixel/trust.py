"""Permission to run what a file names: a program as an engine, or the shell lines of a site.

A file never carries permission. It comes from the user, who names the program on a call of this
process, or has put it into the list of this user: one file for each entry in the user's folder of
settings, outside all projects. The name of that file is the checksum of the command line and of the
files that it names, so that another content is another entry.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

from fixel.engine_names import EngineName
from fixel.errors import InvalidInput, os_reason
from fixel.registry import offers

SERVE: Final = (sys.executable, "-m", offers("programs")["serve"])  # engines of packages
MAX_ENTRY: Final = 1_000_000  # [bytes] of a file of the list
_HIDDEN: Final = re.compile(r" (trust |--(engine|motion|site)=)")  # in commands of files
_permitted: dict[str, list[str]] = {}  # commands that calls of this process named, by checksum


class TrustedEntry(NamedTuple):
    """Entry of the user's list."""

    text: str  # program as after `--engine`, the lines of a site, or a project
    # What is trusted: a command with the checksums of its files, or the lines of a site.
    content: dict[str, Any]
    file: Path  # file of the entry

    @property
    def lines(self) -> list[str]:
        """Text of the entry, and the checksum of each of its files."""
        sums = dict(self.content.get("sha256", {}))
        return [self.text, *(_plain(f"  sha256 {own}  {name}") for name, own in sums.items())]


def list_folder() -> Path:
    """Return the folder of the list: `fixel/trusted` in the user's folder of settings."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.join(os.path.expanduser("~"), ".config")
    return Path(base, "fixel", "trusted")


def command_of(name: EngineName) -> tuple[str, ...]:
    """Return the command line of a program: its whole path, and its arguments."""
    command = _words(name)
    if not _is_file(command[0]):
        raise InvalidInput("engine", found=f"no file {_plain(name.name)}", expected="a program")
    return command


def permit(*motions: object) -> None:
    """Permit this process to run the programs among what a user names on a call.

    Only for arguments of public functions and options of commands, never for a name from a file.
    """
    for motion in motions:
        if isinstance(motion, str) and (name := EngineName.of(motion)).is_program:
            # A missing program is refused where it would be started.
            with contextlib.suppress(InvalidInput):
                content = _content(command_of(name))
                _permitted[_digest(content)] = content["command"]


def remember(motion: str) -> None:
    """Add a program to the user's list, if a call of this process has named it.

    The processes of a job, and those that later use its result, then run it as well.
    """
    if (name := EngineName.of(motion)).is_program:
        content = _content(command_of(name))
        if _digest(content) in _permitted and not is_trusted(content):
            # Without the entry, the other processes refuse the program in a sentence.
            with contextlib.suppress(InvalidInput):
                trust(content)


def check_command(command: Sequence[str]) -> None:
    """Raise `InvalidInput` unless a command line may be run with the present content of its files.

    Engines of installed packages may always be run.
    """
    own = tuple(command)
    if own[: len(SERVE)] == SERVE and len(own) == len(SERVE) + 1:
        return
    content = _content(own)
    if _digest(content) in _permitted or is_trusted(content):
        return
    listed = [entry.content.get("command") for entry in trusted_entries()]
    changed = content["command"] in [*listed, *_permitted.values()]
    why = "has changed since you allowed it" if changed else "was named by a file, not by you"
    found = f"the program {_plain(shlex.join(content['command']))}, which {why}"
    expected = "a program that this call names, or that you trust"
    hint = f"if you know what it does, run: fixel trust {_plain(shlex.quote(_text_of(content)))}"
    raise InvalidInput("program", found=found, expected=expected, hint=hint)


def check_named(*motions: str) -> None:
    """Raise `InvalidInput` if one of the names is that of a program that must not be run."""
    for motion in motions:
        if (name := EngineName.of(motion)).is_program:
            check_command(command_of(name))


def repeatable(command: object) -> str:
    """Return a command of fixel from a file, quoted; empty if it trusts or names a program."""
    try:
        words = shlex.split(str(command))
        check_named(*(x for flag, x in pairwise(words) if flag in ("--engine", "--motion")))
    except (ValueError, InvalidInput):
        return ""
    while "--site" in words:
        del words[(k := words.index("--site")) : k + 2]
    own = shlex.join(words)
    return own if words[:1] == ["fixel"] and not _HIDDEN.search(own) else ""


def trust_program(text: str) -> TrustedEntry:
    """Add a program, such as `./mine.py:fast`, to the user's list, with its files as they are."""
    return trust(_content(command_of(_program(text))))


def trust(content: dict[str, Any]) -> TrustedEntry:
    """Add what a user permits to the list."""
    file = _file_of(content)
    unfinished = file.with_suffix(f".{os.getpid()}")
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        os.replace(unfinished, file)
    except OSError as problem:
        raise InvalidInput(str(file), found=problem, expected="a writable file") from None
    return TrustedEntry(_text_of(content), content, file)


def trusted_entries() -> list[TrustedEntry]:
    """Return the entries of the user's list, in the order of their texts."""
    found = []
    for file in list_folder().glob("*.json"):
        try:
            with file.open("rb") as stream:
                content = json.loads(stream.read(MAX_ENTRY))
            entry = TrustedEntry(_text_of(content), content, file)
            _ = entry.lines
            found.append(entry)
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            continue  # an entry counts by the name of its file; this one cannot be listed
    return sorted(found, key=lambda entry: (entry.text, entry.file))


def distrust(text: str) -> list[TrustedEntry]:
    """Remove a program from the list, with all contents that it has had; return the entries.

    The text is a program, as for `trust_program`, the folder of a project, or that of an entry.
    """
    texts = {text, os.path.realpath(text)}
    if EngineName.of(text).is_program:
        texts.add(_text_of({"command": list(_words(_program(text)))}))
    removed = [own for own in trusted_entries() if {own.text, own.content.get("project")} & texts]
    for entry in removed:
        entry.file.unlink(missing_ok=True)
    return removed


def is_trusted(content: dict[str, Any]) -> bool:
    """Return whether the user's list has an entry with this content."""
    return _file_of(content).is_file()


def _file_of(content: dict[str, Any]) -> Path:
    return list_folder() / f"{_digest(content)}.json"


def _program(text: str) -> EngineName:
    name = EngineName.of(text)
    if not name.is_program:
        expected = "the path of a program, such as ./mine.py"
        raise InvalidInput("program", found=_plain(text), expected=expected)
    return name


def _words(name: EngineName) -> tuple[str, ...]:
    try:
        path = Path(name.name).expanduser().resolve()
    except (OSError, RuntimeError, ValueError):
        path = Path(name.name)
    return (str(path), *filter(None, name.choices.split(",")))


def _text_of(content: Mapping[str, Any]) -> str:
    """Return a program as after `--engine`, lines of a site or a project, for a terminal."""
    if "site" in content:
        return _plain("site: " + "; ".join(map(str, content["site"])))
    if "project" in content:
        leads_to = " and ".join(map(str, content["leads_to"])) or "nothing"
        return _plain(f"project: {content['project']} leads to {leads_to}")
    first, *others = map(str, content["command"])
    return _plain(first + (":" + ",".join(others) if others else ""))


def _content(command: Sequence[str]) -> dict[str, Any]:
    """Return a command line with the SHA-256 checksums of the files that it names."""
    if command[0] == SERVE[0] and command[1:2] and command[1].endswith(".py"):
        command = command[1:]  # the interpreter of fixel
    return {
        "command": list(command),
        "sha256": {word: _checksum(Path(word)) for word in command if _is_file(word)},
    }


def _is_file(word: str) -> bool:
    # Programs are started in an empty folder, where a relative name is no file.
    with contextlib.suppress(ValueError):
        return os.path.isabs(word) and os.path.isfile(word)
    return False


def _checksum(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as problem:
        found = f"{_plain(str(path))} ({os_reason(problem)})"
        raise InvalidInput("engine", found=found, expected="a program") from None


def _digest(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _plain(text: str) -> str:
    """Return text of a file without control characters, which a terminal would obey."""
    return text if text.isprintable() else ascii(text)
