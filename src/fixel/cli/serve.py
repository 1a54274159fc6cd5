"""`fixel serve PROJECT`: the pages of a project in a browser."""

import json
import os
import sys
import tempfile
from html import escape
from pathlib import Path
from typing import Annotated

from fixel.capability.options import Door
from fixel.cli.capability import command
from fixel.cli.screen import ProjectPlace, notify, project_at
from fixel.errors import InvalidInput, plain

LOOPBACK = ("127.0.0.1", "::1", "localhost")


@command
def serve(
    project: Path,
    place: ProjectPlace = None,
    *,
    port: Annotated[int | None, Door(least=1)] = None,
    host: str = "127.0.0.1",
    allow_others: Annotated[bool, Door(flag="--allow-others")] = False,
    open_: Annotated[bool, Door(flag="--open/--no-open")] = True,
    as_json: bool,
) -> None:
    """Show a project in a browser.

    Pages list experiments, simulations, calibrations and domains.

    Parameters
    ----------
    port : int, optional
        Port to listen on; by default any free one.
    host : str
        Address to listen on; others than this machine's own need --allow-others.
    allow_others : bool
        Accept connections from other machines that have the link.
    open_ : bool
        Open the link in a browser.
    """
    if host not in LOOPBACK and not allow_others:
        raise InvalidInput(
            "host",
            found=host,
            expected="an address of this machine only: 127.0.0.1",
            hint="the connection is not encrypted, so others on the network could read the token "
            "in the link; to accept that, add --allow-others",
        )
    from fixel.web.context import ProjectContext
    from fixel.web.project import project_server

    context = ProjectContext(project_at(place, project))
    server = project_server(context, port=port, host=host).start()
    door = None
    try:
        _announce(context.name, server.link, host, as_json)
        if open_ and sys.stdout.isatty() and not as_json:
            door = _door(server.link, context.project.folder)
            if door is not None:
                import webbrowser

                webbrowser.open(door.as_uri())
        server.wait()
    except KeyboardInterrupt:
        notify("fixel: stopped.")
    finally:
        if door is not None:
            door.unlink(missing_ok=True)
        server.stop()
        context.close()
        # A computation whose result is no longer needed must not keep the program alive; records
        # are complete or absent.
        sys.stdout.flush()
        sys.stderr.flush()
        if server.busy:
            os._exit(0)


def _announce(name: str, link: str, host: str, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"project": name, "link": link}), flush=True)
        return
    print(
        f"Open {plain(name)} with this link; "
        f"anyone who has it can read and change the project:\n\n  {link}\n",
        flush=True,
    )
    if host not in LOOPBACK:
        notify("Other machines can connect. The connection is not encrypted.")
    notify("Stop with Ctrl-C.")


def _door(link: str, folder: Path) -> Path | None:
    """Return a file that redirects a browser to a link, to be removed at the end.

    None where there is no screen. The browser receives the file, which only this user can read:
    every user of the machine can read the arguments of a program, and the link holds the token.
    """
    # A browser on a machine without a screen would run in this terminal.
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return None
    where = folder if os.access(folder, os.W_OK) else None
    handle, name = tempfile.mkstemp(prefix="open-", suffix=".html", dir=where)
    door = Path(name).resolve()
    with open(handle, "w", encoding="utf-8") as file:
        file.write(f'<!doctype html><meta http-equiv="refresh" content="0;url={escape(link)}">\n')
    return door
