"""State of a campaign: which rows of a plan were performed, in a journal that survives crashes.

PROJECT/bench/NAME/
    journal             one event for each step of each attempt, durable before the next step
    001-row-name-1/     recording of the first attempt at a row; no attempt is ever deleted
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from fixel.errors import InvalidInput
from fixel.formats.scene_file import SceneFile, scene_dict
from fixel.io.journal import Journal, read_journal
from fixel.model import PlannedExperiment
from fixel.sampling.rig import plain_name

BENCH: Final = "bench"  # folder of a project
JOURNAL: Final = "journal"
ROWS: Final = "rows"  # its first block, the checksum of the rows, and `EMULATED`
EMULATED: Final = b" emulated"

# Of an attempt: begun -> recorded -> tracked -> accepted or repeated; stopped where it has no push.
State = Literal["begun", "stopped", "recorded", "tracked", "accepted", "repeated"]
OPEN: Final = ("recorded", "tracked")  # states that wait for tracking or a decision


class Attempt(NamedTuple):
    """One performance of a row."""

    row: str  # name of the row
    number: int  # number of the attempt at this row, from 1
    state: State
    reasons: tuple[str, ...] = ()  # why it should be repeated, or was stopped
    experiment: int | None = None  # id of the stored experiment

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.row}-{self.number}"


@dataclass(eq=False)
class Campaign:
    """Campaign of experiments at the bench in a folder, open in this process only.

    Raise `InvalidInput` without rows, or if attempts were made at other rows or another bench, and
    `JobRefused` if another process performs it.
    """

    folder: Path
    rows: Sequence[PlannedExperiment]  # of the plan, in order
    emulated: bool = False  # whether its pushes are simulated
    attempts: dict[str, Attempt] = field(default_factory=dict, init=False)  # by name, in order
    skipped: set[str] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        if not self.rows:
            raise InvalidInput("plan", found="no rows", expected="at least one experiment")
        self.by_name = {row.name: row for row in self.rows}
        self.folder.mkdir(parents=True, exist_ok=True)
        self._journal = Journal(self.folder / JOURNAL)
        try:
            self._check_rows()
        except BaseException:
            self._journal.close()
            raise
        self._events = [name for name in self._journal if name != ROWS]
        for name in self._events:
            self._learn(json.loads(self._journal.get(name) or b"{}"))
        # The program died during these pushes: their rows are performed again.
        for attempt in [own for own in self.attempts.values() if own.state == "begun"]:
            self.note(attempt, "stopped", reasons=("the program ended during the push",))

    def _check_rows(self) -> None:
        content = [
            (plain_name(row.name, "plan"), scene_dict(SceneFile(scene=row.scene)))
            for row in self.rows
        ]
        digest = hashlib.sha256(json.dumps(content).encode()).hexdigest().encode()
        begun = digest + EMULATED * self.emulated
        known = self._journal.get(ROWS) or begun
        if known != begun and any(name != ROWS for name in self._journal):
            bench = "an emulated bench" if self.emulated else "real devices"
            found = f"{bench}, other" if known.removesuffix(EMULATED) == digest else "other rows"
            raise InvalidInput(
                "plan",
                found=f"{found} than those with which {self.folder.name} was begun",
                expected="the same plan at the same bench",
                hint="perform this plan under another --name",
            )
        if known != begun:
            self._journal.drop(0)  # of a dry run or a check of the bench, which begin nothing
        self._journal.append([(ROWS, begun)])

    # --- events ---------------------------------------------------------------------------------

    def begin(self, row: str) -> Attempt:
        """Add an attempt at a row, whose folder does not exist yet."""
        return self.note(Attempt(row, 1 + len(self.of(row)), "begun"), "begun")

    def note(
        self,
        attempt: Attempt,
        state: State,
        *,
        reasons: Sequence[str] | None = None,
        experiment: int | None = None,
    ) -> Attempt:
        """Add the next state of an attempt; durable on return."""
        why = attempt.reasons if reasons is None else tuple(reasons)
        known = attempt._replace(state=state, reasons=why, experiment=experiment)
        self._append(known._asdict())
        return known

    def skip(self, row: str) -> None:
        """Leave out a row from now on; its attempts stay."""
        self._append({"row": row, "state": "skipped"})

    def _append(self, event: dict[str, Any]) -> None:
        # A damaged event is missing, and its number must not be used again.
        number = 1 + max(map(int, self._events), default=0)
        self._events.append(f"{number:08d}")
        self._journal.append([(self._events[-1], json.dumps(event).encode())])
        self._learn(event)

    def _learn(self, event: dict[str, Any]) -> None:
        if event.get("state") == "skipped":
            self.skipped.add(event["row"])
        elif "number" in event:
            known = Attempt(**event | {"reasons": tuple(event["reasons"])})
            self.attempts[known.name] = known

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()

    # --- state ----------------------------------------------------------------------------------

    def recording(self, attempt: Attempt) -> Path:
        """Return the folder of the recording of an attempt."""
        return self.folder / attempt.name

    def of(self, row: str) -> list[Attempt]:
        """Return the attempts at a row, oldest first."""
        return [own for own in self.attempts.values() if own.row == row]

    @property
    def accepted(self) -> list[Attempt]:
        """Attempts that are experiments of the project, in the order in which they were stored."""
        return [own for own in self.attempts.values() if own.state == "accepted"]

    @property
    def undecided(self) -> list[Attempt]:
        """Attempts that are recorded, and neither accepted nor to be repeated."""
        return [own for own in self.attempts.values() if own.state in OPEN]

    @property
    def left(self) -> list[PlannedExperiment]:
        """Rows to perform, in the order of the plan."""
        busy = {own.row for own in (*self.accepted, *self.undecided)} | self.skipped
        return [row for row in self.rows if row.name not in busy]


def campaigns(project: Path) -> list[tuple[str, int, int, int]]:
    """Return the campaigns in a project's folder, also those that a program performs now.

    Each has its name and the numbers of accepted and skipped rows and of attempts.
    """
    found = []
    for journal in sorted((project / BENCH).glob(f"*/{JOURNAL}")):
        events = [json.loads(data) for name, data in read_journal(journal) if name != ROWS]
        last = {(own["row"], own["number"]): own["state"] for own in events if "number" in own}
        skipped = {own["row"] for own in events if own["state"] == "skipped"}
        n = sum(state == "accepted" for state in last.values())
        found.append((journal.parent.name, n, len(skipped), len(last)))
    return found
