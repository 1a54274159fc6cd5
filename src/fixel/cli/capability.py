"""Commands of capabilities, made of their options."""

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature, cleandoc
from pathlib import Path
from typing import Annotated, Any

import typer

from fixel.capability.capability import Capability, named
from fixel.capability.options import Option
from fixel.cli.options import AsJson, ProjectFolder, require_folder, require_picture
from fixel.cli.screen import command_of, print_answer, seconds, wrote
from fixel.errors import InvalidInput

DOT = "__"  # for the dot of `group.field`, which no parameter of Python has


def typer_command(capability: Capability) -> Callable[..., None]:
    """Return the function of a capability's command, with a signature for Typer."""

    def command(
        context: typer.Context, project: Path, plot: Path | None, as_json: bool, **given: Any
    ) -> None:
        if context.invoked_subcommand is not None:
            return
        try:
            _run(capability, given, project, plot, as_json)
        except InvalidInput as error:
            raise named(error, capability.flags()) from None

    parameters = [_parameter(capability, option) for option in capability.shown.values()]
    place = (
        typer.Option(help="Draw the result: .png, .svg or .pdf.", metavar="FILE")
        if capability.draws
        else typer.Option(
            help="Folder for charts as PNG and PDF, and their data.", metavar="FOLDER"
        )
    )
    parameters += [
        _keyword("context", typer.Context, Parameter.empty),
        _keyword("project", ProjectFolder, Path()),
        _keyword("plot", Annotated[Path | None, place], None),
        _keyword("as_json", AsJson, False),
    ]
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__doc__ = cleandoc(capability.function.__doc__ or "").partition("\n\nParameters\n")[0]
    return command


def _keyword(name: str, hint: Any, default: Any) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _parameter(capability: Capability, option: Option) -> Parameter:
    """Parameter of an option; all values but those of flags are texts, which the request checks."""
    name, said = option.name.replace(".", DOT), option.meaning
    if option.name == capability.subject:
        argument = typer.Argument(metavar=option.metavar, show_default=False, help=said)
        if option.required:
            return _keyword(name, Annotated[str, argument], Parameter.empty)
        return _keyword(name, Annotated[list[str] | None, argument], None)
    if option.kind is bool:
        flag = typer.Option(option.flag_words, show_default=option.default is not None, help=said)
        return _keyword(name, Annotated[bool | None, flag], option.default)
    usual = option.texts(option.default)
    flags = (option.flag_words, *([option.door.earlier] if option.door.earlier else []))
    info = typer.Option(*flags, metavar=option.metavar, show_default=bool(usual), help=said)
    if option.many:
        return _keyword(name, Annotated[list[str] | None, info], usual or None)
    return _keyword(name, Annotated[str | None, info], usual[0] if usual else None)


def texts_of(capability: Capability, given: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the texts of all shown options, from the values that Typer parsed."""

    def texts(option: Option) -> list[str]:
        value = given[option.name.replace(".", DOT)]
        if isinstance(value, bool):
            return option.texts(value)
        return [value] if isinstance(value, str) else list(value or ())

    return {name: texts(option) for name, option in capability.shown.items()}


def _run(
    capability: Capability, given: dict[str, Any], folder: Path, plot: Path | None, as_json: bool
) -> None:
    from fixel.workflows.capabilities import run

    request = capability.from_texts(texts_of(capability, given))
    (require_picture if capability.draws else require_folder)(plot)
    done = run(capability, request, folder, plot=plot)
    analysis, present = done.analysis, capability.presentation()
    next_words = present.next_words(done.result, capability.words(request), plot is not None)
    print_answer(
        as_json,
        lambda: present.content(analysis, done.folder, done.files),
        lambda: [
            *analysis.lines(),
            "",
            f"Took {seconds(analysis.seconds)}.",
            *wrote(done.files),
            *([] if done.folder is None else [f"stored in {done.folder}"]),
            f"Next: {command_of(*next_words, project=folder)}",
        ],
    )
