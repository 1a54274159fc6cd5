"""Form of the page *Plan*: its content of a goal file."""

import pytest
from pydantic import ValidationError

from fixel.formats.goal_file import goal_file_from_dict
from fixel.web.api.planning import PlanForm
from fixel.web.views.plan_view import as_question


@pytest.mark.parametrize("kind", ["uniform", "normal"])
def test_the_kind_of_the_start_error_reaches_the_plan(kind):
    form = PlanForm(experiment="one", start_mm=2.0, start_deg=0.0, start_kind=kind)
    start = goal_file_from_dict(as_question(form)).belief.start
    assert (start.x, start.y, start.theta, start.kind) == (2e-3, 2e-3, 0.0, kind)


def test_a_form_without_the_kind_is_refused():
    with pytest.raises(ValidationError, match="start_kind"):
        PlanForm(experiment="one", start_mm=2.0)
