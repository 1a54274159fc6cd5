"""Every offer of an upper floor exists, and belongs to a class that exists."""

import json
import subprocess
import sys

import pytest

from fixel.io.saved import _class_of, _known
from fixel.offers import OFFERS, PLOTS
from fixel.registry import offered
from fixel.results import Result

CALLED = [(kind, name) for kind in OFFERS if kind != "saved classes" for name in OFFERS[kind]]


@pytest.mark.parametrize(("kind", "name"), CALLED)
def test_an_offer_can_be_imported(kind, name):
    found = offered(kind, name)
    assert callable(found) or kind in ("jobs", "capability")


def test_plots_and_stores_are_of_results():
    results = {kind.__name__ for path in _known() if issubclass(kind := _class_of(path), Result)}
    assert {*PLOTS, *OFFERS["stores"]} <= results


def test_nothing_that_is_offered_is_imported_with_fixel():
    code = "import json, sys, fixel; print(json.dumps([n for n in sys.modules if 'fixel' in n]))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert set(json.loads(out)) == {"fixel", "fixel.offers", "fixel.registry"}
