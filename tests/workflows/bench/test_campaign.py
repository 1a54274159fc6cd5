"""The journal of a campaign: what was done stays done, whenever the program ends."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from tests.fixtures import refused

from fixel.errors import JobRefused
from fixel.sampling import eight_push_plan
from fixel.workflows.bench.campaign import Campaign, campaigns

ROWS = eight_push_plan().experiments[:4]
NAMES = [row.name for row in ROWS]


def opened(folder):
    return Campaign(folder / "bench" / "pushes", ROWS)


def test_rows_are_performed_once_and_in_order(tmp_path):
    campaign = opened(tmp_path)
    for name in NAMES[:2]:
        attempt = campaign.note(campaign.begin(name), "recorded")
        attempt = campaign.note(attempt, "tracked")
        campaign.note(attempt, "accepted", experiment=7)
    assert [row.name for row in campaign.left] == NAMES[2:]
    campaign.close()

    again = opened(tmp_path)
    assert [row.name for row in again.left] == NAMES[2:]
    assert [own.experiment for own in again.accepted] == [7, 7]
    again.close()
    assert [tuple(own) for own in campaigns(tmp_path)] == [("pushes", 2, 0, 2)]


def test_a_repeated_row_is_performed_again_under_another_folder(tmp_path):
    campaign = opened(tmp_path)
    first = campaign.note(campaign.begin(NAMES[0]), "tracked", reasons=["2 frames were lost"])
    assert campaign.undecided == [first]
    campaign.note(first, "repeated")
    second = campaign.begin(NAMES[0])

    assert campaign.recording(first) != campaign.recording(second)
    assert campaign.of(NAMES[0])[0].reasons == ("2 frames were lost",)
    campaign.close()


def test_a_push_during_which_the_program_died_is_performed_again(tmp_path):
    campaign = opened(tmp_path)
    campaign.begin(NAMES[0])
    campaign.close()

    again = opened(tmp_path)
    assert again.of(NAMES[0])[0].state == "stopped"
    assert again.left[0].name == NAMES[0]
    assert again.begin(NAMES[0]).number == 2
    again.close()


def test_skipped_rows_stay_skipped(tmp_path):
    campaign = opened(tmp_path)
    campaign.skip(NAMES[1])
    campaign.close()
    again = opened(tmp_path)
    assert [row.name for row in again.left] == [NAMES[0], *NAMES[2:]]
    again.close()


def test_another_plan_under_the_same_name_is_refused(tmp_path):
    campaign = opened(tmp_path)
    campaign.begin(NAMES[0])
    campaign.close()
    slower = replace(ROWS[0], scene=replace(ROWS[0].scene, gravity=1.6))
    folder = tmp_path / "bench" / "pushes"
    error = refused(Campaign, folder, [slower, *ROWS[1:]], match="other rows than those")
    assert "--name" in error.hint
    opened(tmp_path).close()  # the refusal has let go of the journal


def test_a_plan_is_free_to_change_before_the_first_attempt(tmp_path):
    """A dry run or a check of the bench opens a campaign, and must not commit its plan."""
    opened(tmp_path).close()
    folder = tmp_path / "bench" / "pushes"
    fewer = Campaign(folder, ROWS[:2])
    fewer.skip(NAMES[0])
    fewer.close()
    refused(Campaign, folder, ROWS, match="other rows than those")
    again = Campaign(folder, ROWS[:2])
    assert [row.name for row in again.left] == [NAMES[1]]
    again.close()


def test_a_rehearsal_is_never_continued_with_real_devices(tmp_path):
    """Devices continue no emulated campaign: its rows would count as done."""
    folder = tmp_path / "bench" / "pushes"
    for first in (True, False):
        campaign = Campaign(folder / str(first), ROWS, emulated=first)
        campaign.note(campaign.begin(NAMES[0]), "accepted", experiment=1)
        campaign.close()
        other = partial(Campaign, folder / str(first), ROWS, emulated=not first)
        named = "real devices, other than" if first else "an emulated bench, other than"
        assert "--name" in refused(other, match=named).hint
        again = Campaign(folder / str(first), ROWS, emulated=first)
        assert len(again.accepted) == 1
        again.close()


def test_two_programs_cannot_perform_the_same_campaign(tmp_path):
    campaign = opened(tmp_path)
    with pytest.raises(JobRefused, match="in use"):
        opened(tmp_path)
    campaign.close()


KILLED = """
import sys, pathlib
sys.path.insert(0, {tests!r})
from tests.workflows.bench.test_campaign import NAMES, opened
campaign = opened(pathlib.Path({folder!r}))
print("open", flush=True)
n = 0
while True:
    campaign.note(campaign.begin(NAMES[0]), "recorded")
    n += 1
    print(n, flush=True)
"""


@pytest.mark.parametrize("after", [1, 7, 40])
def test_a_killed_program_loses_no_event_that_it_has_reported(tmp_path: Path, after: int):
    code = KILLED.format(tests=str(Path(__file__).parents[3]), folder=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "open\n"
        said = [int(child.stdout.readline()) for _ in range(after)][-1]
        os.kill(child.pid, signal.SIGKILL)
        said = max([said, *(int(line) for line in child.stdout if line.endswith("\n"))])

    campaign = opened(tmp_path)
    recorded = [own.number for own in campaign.of(NAMES[0]) if own.state == "recorded"]
    assert recorded == list(range(1, len(recorded) + 1))
    assert said <= len(recorded) <= said + 1
    campaign.close()
