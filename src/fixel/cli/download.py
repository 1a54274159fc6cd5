"""`fixel data`: the public datasets, and fetching a file of one."""

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from fixel.cli.options import AsJson


def data(
    url: Annotated[
        str | None, typer.Argument(help="Address of a file to fetch.", metavar="[URL]")
    ] = None,
    folder: Annotated[
        Path, typer.Option("--output", "-o", help="Where to put it.", metavar="FOLDER")
    ] = Path("data"),
    sha256: Annotated[
        str | None, typer.Option("--sha256", help="Checksum it must have.", metavar="DIGITS")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the public datasets fixel can import; with an address, fetch a file of one."""
    from fixel.workflows.project.download import datasets, fetch

    if url is None:
        known = datasets()
        if as_json:
            typer.echo(json.dumps({"datasets": known}))
            return
        for entry in known:
            typer.echo(f"{entry['name']}\n  {entry['title']}")
            typer.echo(f"  licence: {entry['licence']}\n  cite: {entry['citation']}")
        typer.echo("fixel data URL --sha256 DIGITS fetches a file; fixel import FILE stores it")
        typer.echo("Next: fixel import --help")
        return
    found = fetch(url, folder, sha256)
    if as_json:
        typer.echo(
            json.dumps({"file": str(found.file), "sha256": found.sha256, "bytes": found.n_byte})
        )
        return
    typer.echo(f"fetched {found.file}, {found.n_byte / 1e6:.3g} MB, sha256 {found.sha256}")
    if sha256 is None:
        print("No checksum was asked for: compare this one with the publisher's.", file=sys.stderr)
    typer.echo(f"Next: fixel import {shlex.quote(str(found.file))} --dry-run")
