"""What to type for a map is understood by the command."""

import shlex
from pathlib import Path

from typer.main import get_command

from fixel.cli.main import app
from fixel.domain.claim import Claim
from fixel.model.selection import Bound, ExperimentQuery
from fixel.workflows.domain.request import DomainRequest, command_of


def test_every_option_of_the_command_that_is_written_is_one():
    asked = DomainRequest(
        query=ExperimentQuery(
            dataset="mit", bounds=(Bound("surface", "=", "abs"),), include_faulty=True
        ),
        calibration=3,
        fit=("mu_pusher=0:1:0.2",),
        axes=("offset_y_m",),
        by=("shape",),
        apart=("surface",),
        leave_out="layout",
        nominal={"offset_y_m": 0.0},
        steps={"offset_y_m": 0.016},
        folds=4,
        seed=2,
    )
    claim = Claim(threshold=1.5, level=0.8, confidence=0.9)
    words = shlex.split(command_of(Path("my lab"), asked, claim))
    command = get_command(app).commands["domain"]
    known = {name for option in command.params for name in option.opts}
    assert {word for word in words if word.startswith("--")} <= known
    assert words[:4] == ["fixel", "domain", "--project", "my lab"]
    assert "--all" in words
    relative = Claim(threshold=1.0, measure="relative")
    assert command_of(Path(), DomainRequest(), relative) == "fixel domain --relative 1"
