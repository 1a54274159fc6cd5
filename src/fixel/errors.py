"""Exceptions of fixel.

    FixelError
    ├── InvalidInput(ValueError)        a shape, scene, parameter or option is invalid
    ├── SolveFailed(RuntimeError)       a simulation did not finish, and raising was requested
    ├── DatasetMissing(LookupError)     a folder of recorded data is missing
    ├── NotStored(LookupError)          a project has no such record
    ├── StoreRefused(RuntimeError)      a project cannot be opened, read or written, and why
    ├── JobRefused(RuntimeError)        a job cannot be started, continued or read, and why
    ├── MissingExtra(ImportError)       a package that is not installed, and the command for it
    └── DeviceFailed(RuntimeError)      a device on the bench stopped, or was stopped, and why

`Interrupted` is a `KeyboardInterrupt` with the best result so far.

A numerical failure is not raised by default: `simulate(...)` records a status, and raises
`SolveFailed` only on request.
"""

from __future__ import annotations

import copyreg
import errno
import math
import re
import reprlib
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, final

_CONTROLS: Final = re.compile(r"[\0-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def plain(text: str) -> str:
    """Return text with codes for what a terminal would obey, or a file in UTF-8 cannot have."""
    return _CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text)


def _is_finite(value: object) -> bool:
    return isinstance(value, float) and math.isfinite(value)


class FixelError(Exception):
    """Base class of the exceptions of fixel.

    Examples
    --------
    >>> import fixel
    >>> try:
    ...     fixel.Disk(-1.0)
    ... except fixel.FixelError as problem:
    ...     print(problem)
    disk is -1.0, but must be a number greater than 0 [m]
    """

    def __str__(self) -> str:
        return plain(super().__str__())

    @property
    def details(self) -> dict[str, str | int | float]:
        """Place, value that was found, expectation and hint, as far as they are stated."""
        stated = {key: getattr(self, key, None) for key in ("where", "found", "expected", "hint")}
        return {
            key: own if isinstance(own, str | int) or _is_finite(own) else reprlib.repr(own)
            for key, own in stated.items()
            if own is not None and own is not ...
        }

    def __reduce__(self) -> tuple[Any, ...]:
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


# What pydantic expects, by the kind of its error; other kinds have usable words of its own.
_PHRASES: Final = {
    "missing": "a value: this key is required",
    "float_parsing": "a number",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    "string_type": "text",
    "string_pattern_mismatch": "one line of text of usual characters",
    "string_too_long": "text of at most {max_length} characters",
    "tuple_type": "a list",
    **dict.fromkeys(("dict_type", "model_type"), "keys with values"),
    "bool_type": "true or false",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "too_short": "a list of at least {min_length} entries",
    "too_long": "at most {max_length} entries",
    "value_error": "{error}",
}
_CAUSES: Final = {  # of damaged archives, by a word of their error
    "CRC": "content that differs from its checksum",
    "encrypted": "content with a password",
}
DAMAGED: Final = "damaged, incomplete or foreign content"
_MAX_BEFORE_HINT: Final = 20  # known names that an error with a suggestion lists
_MAX_NAMED: Final = 40  # known names that an error lists
_MAX_FOUND: Final = 300  # [characters] of a text that was found; it may be a whole file

DECIMAL: Final = re.compile(r"\s*[-+]?[0-9]*,[0-9]+([eE][-+]?[0-9]+)?\s*")
_PLACE: Final = re.compile(r"\b(line|row|frame) \d+$")  # place in a file, which is no value
FULL: Final = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))  # no space on the disk

# Strings that are values, not phrases: a quoted text, a length or a range with its unit.
_NUMBER: Final = r"[-+]?[\d.]+(e[-+]?\d+)?"
_VALUE: Final = re.compile(
    r"""(['"])(\\.|(?!\1)[^\\])*\1|"""
    rf"{_NUMBER}( to {_NUMBER})?( ?([cm]?m|deg|m?rad|m?s|kg|px|MB|[cm]?m/s|%))?",
    re.DOTALL,
)


@final
class InvalidInput(FixelError, ValueError):
    """Exception raised for an invalid shape, scene, parameter or option.

    Parameters
    ----------
    where : str
        Path of the value, as in a scene file: `bodies[0].shape.polygon`. Without `found` and
        `expected` it may be the whole sentence.
    found : object
        Value that was found: a number, a quoted text, a length such as `"12 mm"`, a phrase such as
        `"two vertices"`, an exception, or None for a missing value. A string is shown as it is, up
        to 300 characters, anything else as its shortened `repr`.
    expected : str
        Description of allowed values. It continues "must be" after a value, "fixel needs" after
        a phrase, and "give" after None.
    hint : str
        Advice, if there is an obvious one.

    Examples
    --------
    >>> print(InvalidInput("bodies[0].mass", found=-1.0, expected="a positive number of kilograms"))
    bodies[0].mass is -1.0, but must be a positive number of kilograms
    """

    def __init__(
        self,
        where: str,
        *,
        found: object = ...,
        expected: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.where = where
        if isinstance(found, OSError) and found.errno in FULL:
            expected, hint = "free space on the disk", None
        if isinstance(found, Exception):
            found = reason_of(found)
        is_long = isinstance(found, str) and len(found) > _MAX_FOUND
        self.found = f"{str(found)[:_MAX_FOUND]} ..." if is_long else found
        self.expected = expected
        self.hint = hint
        super().__init__(self._sentence())

    def within(self, parent: str) -> InvalidInput:
        """Return the error with a longer path: `mass` within `bodies[0]` is `bodies[0].mass`."""
        joint = "" if self.where.startswith("[") else "."
        return self.at(f"{parent}{joint}{self.where}")

    def at(self, where: str, hint: str | None = None) -> InvalidInput:
        """Return the error at another place, with a hint if it has none."""
        return InvalidInput(where, found=self.found, expected=self.expected, hint=self.hint or hint)

    def _sentence(self) -> str:
        sentence, found, expected = self.where, self.found, self.expected
        is_value = _VALUE.fullmatch(found) if isinstance(found, str) else found is not ...
        if found is None:
            sentence += " is missing" + (f": give {expected}" if expected else "")
        elif is_value and not _PLACE.search(self.where):
            sentence += f" is {_shown(found)}" + (f", but must be {expected}" if expected else "")
        elif found is not ...:
            sentence += f": found {_shown(found)}"
            sentence += f", but fixel needs {expected}" if expected else ""
        elif expected:
            sentence += f": fixel needs {expected}"
        return f"{sentence}; {self.hint}" if self.hint else sentence


@final
class SolveFailed(FixelError, RuntimeError):
    """Exception raised on request when a simulation does not finish.

    Parameters
    ----------
    message : str
        Cause and advice, in one sentence.
    status : str
        Name of the status, as in the record of the simulation: `jammed`, `max_iterations`, ...
    stopped_at : float
        Time of the last step that was solved [s].

    Examples
    --------
    >>> import fixel
    >>> from fixel.testing.scenes import grasp
    >>> try:
    ...     fixel.simulate(grasp(force_limit=None), check=True)
    ... except fixel.SolveFailed as problem:
    ...     print(problem.status)
    jammed
    """

    def __init__(
        self, message: str, *, status: str | None = None, stopped_at: float | None = None
    ) -> None:
        self.message = message
        self.status = status
        self.stopped_at = stopped_at
        super().__init__(message)


@final
class DatasetMissing(FixelError, LookupError):
    """Exception raised when a folder of recorded data is missing.

    Parameters
    ----------
    folder : str or path
        Path of the folder.
    expected : str
        Expected content: `"an inputs.csv"`; None if there is no such file or folder.
    hint : str
        Source of the data.
    """

    def __init__(
        self, folder: str | Path, expected: str | None = None, hint: str | None = None
    ) -> None:
        self.folder = str(folder)
        self.expected = expected
        self.hint = hint
        lacking = f"found no dataset, but fixel needs {expected}"
        sentence = f"{folder}: {lacking if expected else 'no such file or folder'}"
        super().__init__(sentence + (f"; {hint}" if hint else ""))


class NotStored(FixelError, LookupError):
    """Exception raised when a project has no such record.

    Parameters
    ----------
    what : str
        Requested record: `"experiment 12"`.
    hint : str
        Command that lists the records.
    """

    def __init__(self, what: str, hint: str | None = None) -> None:
        self.what = what
        self.hint = hint
        super().__init__(f"there is no {what}" + (f"; {hint}" if hint else ""))


class _WithHint(FixelError, RuntimeError):
    """Exception with a reason and a hint; `is_input` where the cause is a wrong name or address."""

    def __init__(self, reason: str, hint: str | None = None, *, is_input: bool = False) -> None:
        self.reason = reason
        self.hint = hint
        self.is_input = is_input
        super().__init__(f"{reason}; {hint}" if hint else reason)


@final
class StoreRefused(_WithHint):
    """Exception raised when a project cannot be opened, read or written.

    Parameters
    ----------
    reason : str
        Cause: locked by another process, read-only, too new, on a network file system.
    hint : str
        Command that helps.

    Examples
    --------
    >>> import fixel
    >>> try:
    ...     fixel.Project("no_such_folder")
    ... except fixel.StoreRefused as problem:
    ...     print(problem.reason)
    no_such_folder ...
    """


class JobRefused(_WithHint):
    """Exception raised when a job cannot be started, continued or read.

    Parameters
    ----------
    reason : str
        Cause: run by another process, begun with another version, no such command.
    hint : str
        Command that helps.
    """


class DeviceFailed(_WithHint):
    """Exception raised when a device stopped, or was stopped, before it had finished.

    Parameters
    ----------
    reason : str
        Cause: `"hard limit: a limit switch was hit"`.
    hint : str
        Advice.
    """


@final
class MissingExtra(FixelError, ImportError):
    """Exception raised when something needs a package that is not installed.

    Parameters
    ----------
    feature : str
        What needs the package: `"to_pandas"`, `"a posterior"`.
    package : str
        Name of the package.
    extra : str
        Extra of fixel that installs it.
    command : str
        Command that installs it; made from `extra` by default.

    Examples
    --------
    >>> print(MissingExtra("a posterior", "dynesty", extra="infer"))
    a posterior needs the package dynesty; run: pip install 'fixel[infer]'
    """

    def __init__(
        self, feature: str, package: str, *, extra: str = "", command: str | None = None
    ) -> None:
        self.feature = feature
        self.package = package
        self.command = command or f"pip install 'fixel[{extra}]'"
        super().__init__(f"{feature} needs the package {package}; run: {self.command}")


def require(package: str, feature: str, **how: str) -> None:
    """Raise `MissingExtra` if a package is not installed; `how` is its `extra` or `command`."""
    if find_spec(package) is None:
        raise MissingExtra(feature, package, **how)


@final
class Interrupted(KeyboardInterrupt):
    """Exception raised after Ctrl-C, with the best result so far.

    It is a `KeyboardInterrupt`, so that the cells below do not run.

    Parameters
    ----------
    result : object
        Best result so far, with the status "interrupted"; None if there is none yet.
    hint : str
        How to continue.

    Examples
    --------
    >>> print(Interrupted(hint="the same call with store='fits/a' continues"))
    interrupted; the same call with store='fits/a' continues
    """

    def __init__(self, result: Any = None, hint: str = "") -> None:
        self.result = result
        self.hint = hint
        found = "" if result is None else "its result has what was finished"
        super().__init__("; ".join(filter(None, ("interrupted", found, hint))))

    def __reduce__(self) -> tuple[Any, ...]:
        return Interrupted, (self.result, self.hint)


# Errors of the machine, not of fixel: full disk, read-only, no permission, too long a name.
_MACHINE: Final = frozenset(
    getattr(errno, name)
    for name in (
        *("ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "EPERM", "ENAMETOOLONG", "EIO"),
        *("EMFILE", "ENFILE", "ENOMEM", "ENODEV", "ENOTDIR", "ESTALE", "ETXTBSY"),
    )
    if hasattr(errno, name)
)


def closest(name: object, known: Iterable[str]) -> str | None:
    """Return the known name that resembles a misspelt one most; None if none is similar."""
    import difflib

    by_lower = {other.lower(): other for other in known}
    found = difflib.get_close_matches(str(name).lower(), by_lower, n=1)
    return by_lower[found[0]] if found else None


def did_you_mean(name: object, known: Iterable[str]) -> str | None:
    """Return a hint with the known name that resembles a misspelt one; None if none is similar."""
    meant = closest(name, known)
    return None if meant is None else f"did you mean {meant!r}?"


def counted(number: object, what: str) -> str:
    """Return a number of things as text: `1 push`, `2 pushes`."""
    ending = "es" if what.endswith(("sh", "ch")) else "s"
    return f"{number} {what}{'' if str(number) == '1' else ending}"


def some_of(names: Sequence[str], most: int) -> str:
    """Return the first names as text, and how many more there are: `a, b and 3 more`."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


LIST_EXPERIMENTS: Final = "fixel list shows all experiments"


def no_experiments(found: str = "none", expected: str = "at least one experiment") -> InvalidInput:
    """Return the error for a request without experiments."""
    return InvalidInput("experiments", found=found, expected=expected, hint=LIST_EXPERIMENTS)


def unknown_name(where: str, name: object, known: Iterable[str], *, more: str = "") -> InvalidInput:
    """Return the error for an unknown name: it lists the known names and hints at the closest.

    Parameters
    ----------
    where : str
        Path of the value, as in `InvalidInput`.
    name : object
        Name that was found.
    known : iterable of str
    more : str
        Text behind the list of known names.

    Examples
    --------
    >>> print(unknown_name("motion", "dynamc", ("dynamic", "quasistatic")))
    motion is 'dynamc', but must be one of dynamic, quasistatic; did you mean 'dynamic'?
    """
    names = list(known)
    found = "an unknown name" if name == where else repr(name)
    hint = did_you_mean(name, names)
    if hint and len(names) > _MAX_BEFORE_HINT:
        expected = f"one of {len(names)} known names"
        return InvalidInput(where, found=found, expected=expected, hint=hint)
    if len(names) > _MAX_NAMED:
        more = f", ... ({len(names)} in all){more}"
    listed = f"one of {', '.join(names[:_MAX_NAMED])}" if names else "a known name; there is none"
    return InvalidInput(where, found=found, expected=f"{listed}{more}", hint=hint)


def check_name(where: str, name: object, known: Collection[str], *, more: str = "") -> None:
    """Raise `unknown_name` for a name that is not among the known ones."""
    with suppress(TypeError, ValueError):  # of lists and arrays, which are no names
        if name in known:
            return
    raise unknown_name(where, name, known, more=more)


def number_of(text: str, where: str, expected: str = "a number") -> float:
    """Return the finite number of a text in usual digits, unlike `1_0`; raise for other texts."""
    with suppress(ValueError):
        if text.isascii() and "_" not in text and math.isfinite(value := float(text)):
            return value
    hint = "write a decimal point" if DECIMAL.fullmatch(text) else None
    raise InvalidInput(where, found=repr(text), expected=expected, hint=hint)


def refused_value(
    problem: Any, place: str = "", whole: str = "content", known: Collection[str] = ()
) -> InvalidInput:
    """Return the first error of a `ValidationError` of pydantic in words of fixel.

    `place` is the file of the value, `whole` names its content, and `known` has the known keys.
    """
    first = problem.errors()[0]
    key = ".".join(map(str, first["loc"]))
    where = f"{place}: {key or whole}" if place else key or whole
    if first["type"] == "extra_forbidden":
        expected = f"one of {', '.join(known)}" if known else "a known key"
        return InvalidInput(where, found="an unknown key", expected=expected)
    found = None if first["type"] == "missing" else quoted(first["input"])
    own = first["msg"].removeprefix("Input should be ").replace("valid ", "")
    phrase, more = _PHRASES.get(first["type"]), first.get("ctx", {})
    expected = phrase.format(**more) if phrase else own
    if first["type"] == "model_type" and known and not key:
        expected = f"a mapping with the keys {', '.join(known)}"
    expected = getattr(more.get("error"), "expected", None) or expected
    return InvalidInput(where, found=found, expected=expected)


def reason_of(problem: Exception) -> str:
    """Return the reason of an error without the words of Python and of foreign parsers."""
    if isinstance(problem, FixelError):
        return getattr(problem, "reason", None) or str(problem)
    if isinstance(problem, FileNotFoundError):
        return "no such file or folder"
    if isinstance(problem, IsADirectoryError):
        return "a folder"
    if isinstance(problem, OSError) and problem.strerror and type(problem).__module__ == "builtins":
        return f"an error ({os_reason(problem)})"
    if hasattr(problem, "errors") and callable(problem.errors):  # of pydantic
        return str(refused_value(problem))
    if isinstance(problem, UnicodeError):
        return "characters that are not UTF-8"
    if isinstance(problem, RecursionError):
        return "too deeply nested content"
    if isinstance(problem, ArithmeticError):
        return "numbers out of range"
    if line := getattr(problem, "lineno", None):  # of text such as JSON
        return f"an error (line {line}, column {getattr(problem, 'colno', 0)})"
    causes = (cause for word, cause in _CAUSES.items() if word in str(problem))
    return next(causes, DAMAGED)


def os_reason(problem: OSError) -> str:
    """Return the reason that the operating system gives, such as "permission denied"."""
    return (problem.strerror or str(problem)).lower()


def machine_failure(problem: OSError) -> FixelError | None:
    """Return the error for a failure of the machine; None if the program is at fault."""
    if problem.errno not in _MACHINE:
        return None
    reason = os_reason(problem)
    name = str(problem.filename) if problem.filename is not None else ""
    place = f"{name[:80]}...: " if len(name) > 200 else f"{name}: " if name else ""
    hint = "free disk space, then repeat the command" if problem.errno in FULL else None
    return StoreRefused(f"{place}{reason}", hint=hint)


def quoted(value: object) -> object:
    """Return a value as `InvalidInput` shows it: a text in quotes."""
    return repr(value) if isinstance(value, str) else value


def _shown(found: object) -> str:
    return found if isinstance(found, str) else reprlib.repr(found)
