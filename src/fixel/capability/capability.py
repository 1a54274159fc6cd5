"""A capability: one function, and the requests that repeat a call of it."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from inspect import cleandoc, signature
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from fixel.capability.options import TABLE, Option, is_group, members, options_of
from fixel.errors import InvalidInput, refused_value, unknown_name

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

_LIMITS: Final = dict(  # of a JSON schema, by the field of a door
    minimum="least", exclusiveMinimum="above", maximum="most", exclusiveMaximum="below"
)


@dataclass(frozen=True, kw_only=True)
class Capability:
    """A function whose arguments are the options of every door.

    Parameters
    ----------
    name : str
        Name of the command, of pages and of stored results.
    title : str
        Title of the page; the name by default.
    function : callable
        `([project], *places, *, ..., progress=None) -> result`. Arguments that Python could pass
        by position are typed without a flag. It gets None in a folder that is no project, if it
        annotates that. Its module imports nothing heavy. That module, or `report` in the same
        folder, reports results: `report_of(result)`, an `AnalysisReport`; `JSON`, names of what
        `--json` has besides numbers, or `content(done)`, its content of a `StoredAnswer`;
        `next_words(done)`, words of the next command or none; `draw(result, path)` if `plot` is
        `"file"`; where a run can fail, `failed(result)`, and `EXIT`, the exit code if it is not 3;
        `add_files(result, folder)` for files of the stored analysis; and `about()`, tables below
        the form of the page.
    of : callable, optional
        Function or dataclass whose arguments are options too.
    leave_out : tuple of str
        Arguments of `of` that only Python has.
    plot : str
        What `--plot` names: a `"folder"` to which the stored figures are copied, one `"file"`, or
        nothing (`""`) where there is no such option.
    rounds : callable, optional
        The same as `function` as a generator of `fixel.jobs.work.Round`, for jobs that distribute
        chunks: it gets the folder of the job's inputs as `inputs`, and returns the result.
    settled : callable, optional
        `(project, request) -> request` that a job does, which no later record or file can change.
    inputs : callable, optional
        `(project, request) -> files` by name from which `rounds` compute without a project. They
        store records of their own and return bytes; no analysis is stored.
    group : str
        Command whose sub-command it is.
    verb : str
        Name of the sub-command, if not that of the capability.
    in_project : callable, optional
        Returns whether a request needs the project, without which the function gets None; by
        default every request does, or uses the project of the folder if there is one.
    on_table : bool
        Whether the option `TABLE` puts experiments of the project on a mapped table. The function
        gets a project with these experiments instead of the option.
    """

    name: str
    title: str = ""
    function: Callable[..., Any]
    of: Callable[..., Any] | None = None
    leave_out: tuple[str, ...] = ()
    plot: Literal["folder", "file", ""] = "folder"
    rounds: Callable[..., Any] | None = None
    settled: Callable[..., Any] | None = None
    inputs: Callable[..., Any] | None = None
    group: str = ""
    verb: str = ""
    in_project: Callable[[Any], bool] | None = None
    on_table: bool = False

    @property
    def heading(self) -> str:
        """Title of its page."""
        return self.title or self.name.capitalize().replace("-", " ")

    @property
    def summary(self) -> str:
        """First sentence of the docstring."""
        return cleandoc(self.function.__doc__ or "").partition("\n\n")[0].replace("\n", " ")

    @property
    def path(self) -> list[str]:
        """Words of the command."""
        return [*([self.group] if self.group else []), self.verb or self.name]

    @property
    def present(self) -> ModuleType:
        """Module that reports results: that of the function, or `report` in the same folder."""
        own = sys.modules[self.function.__module__]
        return own if hasattr(own, "report_of") else import_module(f"{own.__package__}.report")

    @property
    def on_project(self) -> bool:
        """Whether the function works on a project."""
        return "project" in signature(self.function).parameters

    @property
    def needs_project(self) -> bool:
        """Whether it cannot do without one."""
        own = signature(self.function).parameters.get("project")
        return own is not None and "None" not in own.annotation

    @cached_property
    def options(self) -> dict[str, Option]:
        """Options by name; those that are typed without a flag come first."""
        own = options_of(self.function, leave_out=("project", "progress", "as_json"))
        first = sum(one.place for one in own)
        known = ("project", "progress", *self.leave_out, *(one.name for one in own))
        others = [] if self.of is None else options_of(self.of, leave_out=known)
        others = [replace(one, place=False) for one in others]
        last = [TABLE] if self.on_table else []
        return {one.name: one for one in (*own[:first], *others, *own[first:], *last)}

    @cached_property
    def shown(self) -> dict[str, Option]:
        """Options as doors show them, with the fields of groups."""
        return {o.name: o for option in self.options.values() for o in members(option)}

    # --- requests -------------------------------------------------------------------------------

    @cached_property
    def model(self) -> type[BaseModel]:
        """Class of the requests, which checks them and converts them to JSON and back."""
        from pydantic import BeforeValidator, ConfigDict, Field, create_model

        def checked(option: Option) -> Any:
            door = option.door
            limits = {name: getattr(door, own) for name, own in _LIMITS.items()}
            shown: Any = {name: limit for name, limit in limits.items() if limit is not None}
            stated = Field(description=option.meaning or None, json_schema_extra=shown)
            kind: Any = Annotated[option.plain, stated]
            if is_group(option.kind) or option.kind in (int, float):
                kind = Annotated[kind, BeforeValidator(option.before)]
            return kind, ... if option.required else option.default

        config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
        fields: Any = {name: checked(option) for name, option in self.options.items()}
        return create_model(f"{self.name.capitalize()}Request", __config__=config, **fields)

    def request(self, values: Mapping[str, Any]) -> BaseModel:
        """Return the checked request of values in SI units; raise `InvalidInput` for a fault."""
        return self._checked(lambda: self.model(**values))

    def asked(self, call: Mapping[str, Any]) -> BaseModel:
        """Return the checked request of a call, from the `locals()` at the begin of a function."""
        own = {name: value for name, value in call.items() if name in self.options}
        if self.on_table:
            own[TABLE.name] = getattr(getattr(call.get("project"), "view", None), "path", None)
        own |= call.get("options", {})
        own.pop("progress", None)
        return self.request(own)

    def from_json(self, text: str | bytes) -> BaseModel:
        """Return the request that a text in JSON states; inverse of `model_dump_json`."""
        return self._checked(lambda: self.model.model_validate_json(text, strict=True))

    def _checked(self, make: Callable[[], BaseModel]) -> BaseModel:
        from pydantic import ValidationError

        try:
            request = make()
        except ValidationError as problem:
            raise self._refusal(problem) from None
        for name, value in self._values(request).items():
            self.shown[name].check(value)
        return request

    def _values(self, request: BaseModel) -> dict[str, Any]:
        """Return the values of all shown options."""
        found = {}
        for name in self.shown:
            group, _, own = name.partition(".")
            value = getattr(request, group)
            found[name] = getattr(value, own, None) if own else value
        return found

    def from_texts(self, texts: Mapping[str, Sequence[str]]) -> BaseModel:
        """Return the request of texts by the name of the shown option; none for the default."""
        values: dict[str, Any] = {}
        for name, option in self.shown.items():
            if given := texts.get(name):
                group, _, own = name.partition(".")
                holder = values.setdefault(group, {}) if own else values
                holder[own or name] = option.parsed(given)
        return self.request(values)

    @property
    def usual_texts(self) -> dict[str, list[str]]:
        """Texts of the defaults of all shown options."""
        return {name: option.texts(option.default) for name, option in self.shown.items()}

    def texts(self, request: BaseModel) -> dict[str, list[str]]:
        """Return texts of all shown options; inverse of `from_texts`."""
        return {k: self.shown[k].texts(value) for k, value in self._values(request).items()}

    def question(self, request: BaseModel) -> dict[str, Any]:
        """Return the request as plain content, without a table and options that change no result.

        Files have their whole path.
        """
        effort = {name for name, option in self.options.items() if option.door.effort}
        content = request.model_dump(mode="json", exclude={TABLE.name, *effort})
        files = {name: value for name, value in request if isinstance(value, Path)}
        return content | {k: str(path.resolve()) for k, path in files.items() if k in content}

    def words(self, request: BaseModel) -> list[str]:
        """Return the words of the command that repeats a request."""
        usual = self.usual_texts
        words: list[str] = []
        for name, texts in self.texts(request).items():
            option = self.shown[name]
            if texts == usual[name]:
                continue
            if option.place:
                words += texts
            elif option.kind is bool:
                words.append(option.flag_words.split("/")[texts == ["no"]])
            else:
                words += [word for text in texts for word in (option.flag, text)]
        return [*self.path, *words]

    def command(self, request: BaseModel, folder: Path = Path()) -> str:
        """Return the shell command that repeats a request on the project in a folder."""
        project = [] if folder == Path() else ["--project", str(folder)]
        return shlex.join(["fixel", *self.words(request), *project])

    def arguments(self, request: BaseModel) -> dict[str, Any]:
        """Return the arguments of the function, with the objects of groups."""
        own = [name for name in self.options if not (self.on_table and name == TABLE.name)]
        values = {name: getattr(request, name) for name in own}
        groups = {name for name, option in self.options.items() if is_group(option.kind)}
        return {k: v.build() if v and k in groups else v for k, v in values.items()}

    def programs(self, request: BaseModel) -> list[str]:
        """Return the values of a request that may name a program to run."""
        own = (name for name, option in self.options.items() if option.door.program)
        return [value for name in own if (value := getattr(request, name))]

    def files(self, request: BaseModel) -> dict[str, Path]:
        """Return the files that the function writes, by the name of their option."""
        own = (name for name, option in self.options.items() if option.door.writes)
        return {name: value for name in own if (value := getattr(request, name))}

    def reads(self, request: BaseModel) -> dict[str, str]:
        """Return the checksums of the files that the function reads, by their paths.

        The scene of a goal in JSON is one; a mapped table, of which a job has a copy, is not.
        """
        own = {o: getattr(request, name) for name, o in self.options.items() if o is not TABLE}
        named = [x for option, x in own.items() if option.kind is Path and not option.door.writes]
        named += [json.loads(x).get("scene") for option, x in own.items() if option.door.content]
        found = [Path(one) for one in named if one and Path(one).is_file()]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}

    # --- errors ---------------------------------------------------------------------------------

    def flags(self) -> dict[str, str]:
        """Return the flag of each argument, for errors of the command."""
        return self._names({k: o.flag for k, o in self.shown.items() if not o.place})

    def labels(self) -> dict[str, str]:
        """Return the label of each argument, for errors of the page."""
        return self._names({name: option.label for name, option in self.shown.items()})

    def keys(self) -> dict[str, str]:
        """Return the key of each argument, for errors of a request in JSON."""
        return self._names({name: name for name in self.shown})

    def _names(self, own: dict[str, str]) -> dict[str, str]:
        """Add the names of groups, and those that errors of programs and parameters have."""
        from fixel.model.parameters import KNOWN_PARAMETERS

        found = {name.partition(".")[0]: text for name, text in reversed(own.items())} | own
        for name, text in own.items():
            door = self.shown[name].door
            if door.program:
                found = dict.fromkeys(("motion", "engine"), text) | found
            if door.flag == "--set":  # a value may be refused by the name of its parameter
                own_names = {key: f"{text} {key}" for key in KNOWN_PARAMETERS}
                found = {"parameters": text} | own_names | found
        return found

    def _refusal(self, problem: ValidationError) -> InvalidInput:
        extra = "unexpected_keyword_argument"  # if a name is misspelled, it is also missing
        first = min(problem.errors(include_url=False), key=lambda one: one["type"] != extra)
        kind = first["type"]
        if not first["loc"]:  # of a text that is no JSON, or no object
            return InvalidInput("request", found="another text", expected="an object in JSON")
        name, *rest = map(str, first["loc"])
        if name not in self.options:
            return unknown_name(f"option of {self.name}", name, tuple(self.options))
        own = f"{name}.{rest[0]}" if rest else name
        if kind == extra:
            known = [k.partition(".")[2] for k in self.shown if k.startswith(f"{name}.")]
            return unknown_name(name, rest[0], known)
        where = own if own in self.shown else " ".join([name, *rest[:1]])
        if kind == "missing":
            if rest:
                return InvalidInput(where, found="only one of them", expected="both, or neither")
            hint = self.shown[where].help.rstrip(".")
            return InvalidInput(where, found=None, hint=hint[:1].lower() + hint[1:])
        if kind == "too_long":  # of a pair
            expected = f"a list of {first['ctx']['max_length']}"
            return InvalidInput(where, found=first["input"], expected=expected)
        return refused_value(problem).at(where)


def named(error: InvalidInput, names: Mapping[str, str]) -> InvalidInput:
    """Return an error with the names of a door instead of those of arguments.

    The `where` of the error begins with an argument (`nominal side`), or `filter`, which is that
    of `where`; its hint may set one (`folds=2`). `names` has the name of each argument at the door.
    """
    name, space, rest = re.sub(r"^parameters\.", "parameters ", error.where).partition(" ")
    is_filter = name.rstrip(":") == "filter" and "where" in names
    name = "where" if is_filter else name.removeprefix("filter.")
    where, hint = f"{names.get(name, name)}{space}{rest}", named_hint(error.hint or "", names)
    return InvalidInput(where, found=error.found, expected=error.expected, hint=hint or None)


def named_hint(hint: str, names: Mapping[str, str]) -> str:
    """Return a hint with the names of a door instead of arguments that it sets."""
    return re.sub(r"(?<!=)\b([a-z_]+)=(True|False)?", lambda one: _setting(one, names), hint)


def _setting(found: re.Match[str], names: Mapping[str, str]) -> str:
    own = names.get(found[1])
    if own is None:
        return found[0]
    if not found[2]:
        return f"{own}=" if "--option " in own else f"{own} "
    if own.startswith("--"):
        return own if found[2] == "True" else f"--no-{own[2:]}"
    return f"{own} {'on' if found[2] == 'True' else 'off'}"
