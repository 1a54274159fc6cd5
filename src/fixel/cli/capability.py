"""Commands of capabilities, made of their options."""

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature, cleandoc, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fixel.capability.capability import Capability, named, named_hint
from fixel.capability.options import Option
from fixel.cli import screen
from fixel.errors import Interrupted, InvalidInput
from fixel.progress import time_text

if TYPE_CHECKING:
    from pydantic import BaseModel

DOT = "__"  # for the dot of `group.field`, which no parameter of Python has
NOT_SOLVED = 3  # exit code of a simulation that stopped early
_PLOT = {
    "file": typer.Option(help="Draw the result: .png, .svg or .pdf.", metavar="FILE"),
    "folder": typer.Option(help="Folder for charts as PNG and PDF, and their data.",
                           metavar="FOLDER"),
}  # fmt: skip
_PREPARE = Annotated[
    bool, typer.Option("--prepare", help="Only prepare a job, for fixel jobs submit.")
]


def typer_commands(name: str, every: Mapping[str, Capability], said: str = "") -> typer.Typer:
    """Return the commands of a group; one of its own name is the command without a sub-command."""
    own = typer_command(every[name]) if name in every else None
    app = typer.Typer(
        help=own.__doc__ if own else said,
        invoke_without_command=own is not None,
        no_args_is_help=own is None,
        rich_markup_mode=None,
    )
    if own:
        app.callback()(own)
    for one in every.values():
        if one.group == name:
            app.command(one.verb or one.name)(typer_command(one))
    return app


def typer_command(
    capability: Capability, perform: Callable[["BaseModel", Path, bool], None] | None = None
) -> Callable[..., None]:
    """Return the function of a capability's command, with a signature for Typer.

    Where that is not one call of the function, `perform` runs a request on the project in a folder,
    and prints the answer as JSON or text.
    """

    def command(
        context: typer.Context, as_json: bool, project: Path = Path(), **given: Any
    ) -> None:
        if context.invoked_subcommand is not None:
            return
        plot = given.pop("plot") if capability.plot else None
        prepare_only = given.pop("prepare_only", False)
        try:
            request = _request(capability, given)
            if perform is not None:
                perform(request, project, as_json)
            elif prepare_only:
                if plot is not None:
                    raise InvalidInput("--plot", found="--prepare too", expected="one of them")
                _prepare(capability, request, project, as_json)
            else:
                _run(capability, request, project, plot, as_json)
        except InvalidInput as error:
            names = capability.flags() | {"project": "--project"}
            texts, shown = texts_of(capability, given), capability.shown.values()
            typed = {path for own in shown if own.kind is Path for path in texts[own.name]}
            raise named(error, {k: v for k, v in names.items() if k not in typed}) from None
        except Interrupted as stop:
            stop.hint = named_hint(stop.hint, capability.flags())
            raise

    parameters = [_parameter(option) for option in capability.shown.values()]
    parameters.append(_keyword("context", typer.Context, Parameter.empty))
    if capability.on_project:
        parameters.append(_keyword("project", screen.ProjectFolder, Path()))
    if capability.on_project and perform is None:
        parameters.append(_keyword("prepare_only", _PREPARE, False))
    if capability.plot:
        parameters.append(_keyword("plot", Annotated[Path | None, _PLOT[capability.plot]], None))
    parameters.append(_keyword("as_json", screen.AsJson, False))
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__doc__ = cleandoc(capability.function.__doc__ or "").partition("\n\nParameters\n")[0]
    return command


def command(
    function: Callable[..., screen.CommandAnswer | None], *, of: Callable[..., Any] | None = None
) -> Callable[..., None]:
    """Return the command of a function whose answer is only printed.

    The arguments are those of a `Capability`. A function that prints while it works gets `as_json`,
    and returns None.
    """
    capability = Capability(name=function.__name__, function=function, of=of, plot="")
    prints = "as_json" in signature(function).parameters

    def perform(request: "BaseModel", folder: Path, as_json: bool) -> None:
        from fixel.workflows.capabilities import project_for

        place = project_for(capability, request, folder)
        own = {"as_json": as_json} if prints else {}
        answer = function(*place, **capability.arguments(request), **own)
        if answer is None:
            return
        screen.print_answer(as_json, lambda: answer.content, lambda: answer.lines)
        if answer.code:
            raise typer.Exit(answer.code)

    return typer_command(capability, perform)


def subcommand(
    group: typer.Typer, name: str
) -> Callable[[Callable[..., screen.CommandAnswer | None]], Callable[..., None]]:
    """Return the decorator that makes a function a command of a group."""
    return lambda function: group.command(name)(command(function))


def _keyword(name: str, hint: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _parameter(option: Option) -> Parameter:
    """Parameter of an option; all values but those of flags are texts, which the request checks."""
    name, said = option.name.replace(".", DOT), option.help
    usual = option.texts(option.default)
    shown: Any = option.door.usual or bool(usual)
    several = option.many or bool(option.door.also)  # two names of one option are refused together
    kind: Any = list[str] if several else str
    default = (usual or None) if several else usual[0] if usual else None
    if option.place:
        argument = typer.Argument(metavar=option.metavar, show_default=shown, help=said)
        if option.required:
            return _keyword(name, Annotated[kind, argument], Parameter.empty)
        return _keyword(name, Annotated[kind | None, argument], default)
    words = (option.flag_words, *option.door.also)
    said = f"Required. {said}" if option.required else said
    if option.kind is bool:
        flag = typer.Option(*words, show_default=option.default is not None, help=said)
        return _keyword(name, Annotated[bool | None, flag], option.default)
    info = typer.Option(*words, metavar=option.metavar, show_default=shown, help=said)
    return _keyword(name, Annotated[kind | None, info], default)


def texts_of(capability: Capability, given: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the texts of all shown options, from the values that Typer parsed."""

    def texts(option: Option) -> list[str]:
        value = given[option.name.replace(".", DOT)]
        if isinstance(value, bool):
            return option.texts(value)
        return [value] if isinstance(value, str) else list(value or ())

    return {name: texts(option) for name, option in capability.shown.items()}


def _request(capability: Capability, given: Mapping[str, Any]) -> "BaseModel":
    """Return the checked request, and permit programs that the user of this command has typed."""
    from fixel.trust import permit

    request = capability.from_texts(texts_of(capability, given))
    permit(*capability.programs(request))
    return request


def _prepare(capability: Capability, request: "BaseModel", folder: Path, as_json: bool) -> None:
    from fixel.database.project import Project
    from fixel.workflows.capabilities import prepare

    job = prepare(capability, request, Project(folder))
    submit = screen.command_of("jobs", "submit", job)
    screen.print_answer(
        as_json, lambda: {"job": str(job)}, lambda: [f"Prepared {job}", f"Next: {submit}"]
    )


def _run(
    capability: Capability, request: "BaseModel", folder: Path, plot: Path | None, as_json: bool
) -> None:
    from fixel.workflows.analysis import content_of
    from fixel.workflows.capabilities import run

    (screen.require_picture if capability.plot == "file" else screen.require_folder)(plot)
    done = run(capability, request, folder, plot=plot)
    analysis, present = done.analysis, capability.present
    words = present.next_words(done)
    kept = [] if done.folder is None else [f"stored in {done.folder}"]

    def content() -> dict[str, Any]:
        own = getattr(present, "content", content_of)(done)
        return own | analysis.texts() | own  # texts follow, and do not replace what it states

    screen.print_answer(
        as_json,
        content,
        lambda: screen.paragraphs(
            analysis.lines(),
            [f"Took {time_text(analysis.seconds)}.", *screen.wrote(done.files.values()), *kept],
            [f"Next: {screen.command_of(*words, project=folder)}"] if words else [],
        ),
    )
    if done.failed:
        raise typer.Exit(getattr(present, "EXIT", NOT_SOLVED))
