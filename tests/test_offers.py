"""Every offer of an upper floor exists, and belongs to a class that exists."""

import json
import subprocess
import sys
from dataclasses import is_dataclass
from typing import get_args

import pytest

from fixel.io.saved import _class_of, _hints, _known
from fixel.offers import OFFERS, PLOTS
from fixel.registry import offered
from fixel.results import Result

CALLED = [(kind, name) for kind in OFFERS if kind != "saved classes" for name in OFFERS[kind]]


@pytest.mark.parametrize(("kind", "name"), CALLED)
def test_an_offer_can_be_imported(kind, name):
    assert callable(offered(kind, name)) or kind in ("jobs", "capability", "programs")


def _inside(hint):
    """Yield the classes of a type hint."""
    if isinstance(hint, type):
        yield hint
    for part in get_args(hint):
        yield from _inside(part)


def test_what_a_saved_class_contains_can_be_saved():
    kinds = [_class_of(name) for name in _known()]
    inside = {one for kind in kinds for hint in _hints(kind).values() for one in _inside(hint)}
    final = {one for one in inside if not one.__subclasses__() and is_dataclass(one)}
    assert {one for one in final if one.__module__.startswith("fixel.")} <= {*kinds}


def test_plots_and_stores_are_of_results():
    results = {kind.__name__ for path in _known() if issubclass(kind := _class_of(path), Result)}
    assert {*PLOTS, *OFFERS["stores"]} <= results


def test_nothing_that_is_offered_is_imported_with_fixel():
    code = "import json, sys, fixel; print(json.dumps([n for n in sys.modules if 'fixel' in n]))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert set(json.loads(out)) == {"fixel", "fixel.offers", "fixel.registry"}
