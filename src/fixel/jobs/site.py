"""Site templates: settings for the jobs of a cluster, as a small YAML file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from fixel.errors import InvalidInput, refused_value
from fixel.io.document import read_document
from fixel.model.fields import path_of
from fixel.trust import is_trusted, trust

# One directive, one line: a value in a template cannot add other lines to the script.
_LINE: Final = r"[^\r\n]*"
_WORD: Final = r"[^\s%]+"
_MEMORY: Final = r"[0-9]+(\.[0-9]+)? ?[KMGT]i?B"
_WALLTIME: Final = re.compile(r"(?:(\d+)-)?(\d{1,3}):(\d{2}):(\d{2})")

Line = Annotated[str, Field(pattern=f"^{_LINE}$")]
Word = Annotated[str, Field(pattern=f"^{_WORD}$")]


def _size(text: str) -> str:
    """Return a size of memory; raise for another text."""
    if not re.fullmatch(_MEMORY, text):
        raise ValueError("a size such as 4 GB")
    return text


TEMPLATE: Final = """\
# A cluster, for `fixel jobs submit --site THIS_FILE`. Edit the lines that your site requires.
scheduler: slurm
queue: main              # partition: `sinfo` lists them
# account: my_group      # account that is charged, if your site has accounts
walltime: "01:00:00"     # time limit of one worker; it ends by itself before and is replaced
cores: 4                 # cores of one worker; each chunk uses all of them
memory: 4 GB             # memory of one worker
interface: ib0           # interface of all nodes, see `ip -brief address`; lo for one machine
max_jobs: 16             # maximum number of workers in the queue
submit_interval_s: 1.0   # shortest time between two submissions
# directives:            # additional lines of #SBATCH
#   - --qos=long
# skip_directives:       # lines to omit: those that contain one of these texts
#   - --mem
# prologue:              # shell commands before a worker starts
#   - module load python/3.12
# python: /home/me/fixel/.venv/bin/python    # default: that of this command
"""


class Site(BaseModel):
    """Settings for the jobs of a cluster."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scheduler: Literal["slurm"] = "slurm"
    queue: Word | None = None
    account: Word | None = None
    walltime: Line = "01:00:00"  # time limit of one worker: `HH:MM:SS` or `D-HH:MM:SS`
    cores: int = Field(default=1, ge=1, le=1024)
    memory: Annotated[str, AfterValidator(_size)] = "2 GB"  # memory of one worker: `4 GB`
    interface: Word = "lo"  # only network interface that the processes listen on
    max_jobs: int = Field(default=16, ge=1, le=10_000)  # maximum number of workers in the queue
    # Shortest time between two submissions [s].
    submit_interval_s: float = Field(default=1.0, ge=0.0, le=3600.0)
    # Lines for the scheduler; directives to leave out; shell lines before the worker.
    directives: list[Line] = []
    skip_directives: list[Line] = []
    prologue: list[Line] = []
    python: Line | None = None  # interpreter on the nodes, if it is not the same as here

    @property
    def shell_lines(self) -> list[str]:
        """Lines that the nodes run, or that the scheduler obeys, as the template has them."""
        python = [] if self.python is None else [f"python: {self.python}"]
        return [*self.directives, *self.prologue, *python]

    @property
    def walltime_s(self) -> float:
        """Time limit of one worker [s]."""
        match = _WALLTIME.fullmatch(self.walltime)
        if match is None:
            raise InvalidInput(
                "walltime", found=repr(self.walltime), expected="HH:MM:SS or D-HH:MM:SS, in quotes"
            )
        days, hours, minutes, seconds = (int(part or 0) for part in match.groups())
        return float(((days * 24 + hours) * 60 + minutes) * 60 + seconds)

    @property
    def lifetime_s(self) -> float:
        """Time after which a worker ends by itself, before the limit so that its chunk ends [s]."""
        return self.walltime_s - min(120.0, 0.2 * self.walltime_s)


def load_site(path: Path) -> Site:
    """Load a site template."""
    return site_of(read_document(path_of(path, "site"), "site file"), str(path))


def site_of(content: object, where: str) -> Site:
    """Return the site that the content of a file describes; `where` names it in errors."""
    try:
        site = Site.model_validate(content)
    except ValidationError as problem:
        raise refused_value(problem, where, "site", Site.model_fields) from None
    if site.walltime_s < 10.0:
        raise InvalidInput(
            f"{where}: walltime", found=repr(site.walltime), expected="at least 00:00:10"
        )
    return site


def trust_site(site: Site) -> None:
    """Add the lines of a site that the user names on a call to the user's list."""
    if site.shell_lines and not is_trusted({"site": site.shell_lines}):
        trust({"site": site.shell_lines})


def check_site(site: Site) -> None:
    """Raise `InvalidInput` for lines of a site that only the folder of a job names."""
    if site.shell_lines and not is_trusted({"site": site.shell_lines}):
        found = f"lines in the folder of the job that you have not named: {site.shell_lines}"
        expected = "the lines of a site template of yours"
        hint = "read them, and name the template again: fixel jobs resume FOLDER --site FILE"
        raise InvalidInput("site", found=found, expected=expected, hint=hint)
