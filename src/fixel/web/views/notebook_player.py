"""Player for a cell of a notebook: that of the pages, with its data and without a server."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib.resources import files
from typing import Final

import numpy as np

from fixel.drawing.view import evenly
from fixel.results import Player
from fixel.simulation import Simulation
from fixel.web.palette import palette_css
from fixel.web.views.motion_views import Animation, animation_of_scene, simulated_motion

MODULES: Final = ("dom", "motion", "stage", "view", "player")  # each imports those before it
MAX_NUMBERS: Final = 10_000  # of eight bytes each
PAGE: Final = """<!doctype html><meta charset="utf-8"><title>fixel</title><style>{style}
body {{ padding: 2px; background: none; }} .player {{ height: 100%; }}</style>
<div id="player"></div><script type="module">{script}
new Player(document.getElementById("player"), {{ keys: false }}).show({motions});</script>"""


def player_of_simulation(simulation: Simulation) -> Player:
    """Return the player of a simulation, with at most about `MAX_NUMBERS` of its numbers."""
    n = len(simulation.time)
    numbers = 3 * n * len(simulation.pose) + 7 * len(simulation.contacts)
    rows = evenly(n, max(2, MAX_NUMBERS * n // numbers))
    time, contacts = simulation.time[rows], simulation.contacts
    shown = replace(
        simulation,
        time=time,
        pose={name: pose[rows] for name, pose in simulation.pose.items()},
        contacts=contacts[np.isin(contacts["time"], time)],
    )
    return player_of(animation_of_scene(simulation.scene, [simulated_motion(shown)], "simulation"))


def player_of(animation: Animation) -> Player:
    """Return the player of motions."""
    static = files("fixel.web") / "static"
    sheets = ("style.css", "player.css")
    style, own = (static.joinpath(name).read_text("utf-8").split("/* --- ") for name in sheets)
    script = "".join(static.joinpath(f"{name}.js").read_text("utf-8") for name in MODULES)
    motions = animation.model_dump_json(by_alias=True)
    return Player(
        PAGE.format(
            style=_shortened("".join((*style[:3], palette_css().split(".p0 ")[0], own[0]))),
            script=_shortened(script),
            motions=motions.replace("<", r"\u003c"),  # a name may look like the end of the script
        )
    )


def _shortened(code: str) -> str:
    """Return code without comments, indents, and what joins its modules."""
    code = re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)
    return re.sub(r"^\s*//.*|^import .*|^export (?=\w)|^\s+", "", code, flags=re.MULTILINE)
