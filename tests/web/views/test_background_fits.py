"""Fits beside the server: one for all who ask, ended when nobody does."""

import math
import time

import pytest

from fixel.errors import JobRefused
from fixel.web.views import background_fits
from fixel.web.views.background_fits import Fits

ENDS = 60.0  # [s] for a process to start on a busy machine


def test_an_answer_comes_once_and_a_failure_is_told_to_who_asks_next():
    roots, answers = Fits(math.sqrt), []
    good, bad = roots.begun("4", 4.0, answers.append), roots.begun("-1", -1.0, answers.append)
    assert roots.begun("4", 4.0, answers.append) is good
    assert good.ended.wait(ENDS)
    assert bad.ended.wait(ENDS)
    assert answers == [2.0]
    assert roots.joined("4") is None
    with pytest.raises(ValueError, match="domain"):
        roots.joined("-1")
    assert roots.joined("-1") is None


def test_one_that_is_joined_is_stopped_for_all():
    sleeps, answers = Fits(time.sleep), []
    fit = sleeps.begun("long", 1000.0, answers.append)
    assert sleeps.joined("long") is fit
    begun = time.monotonic()
    sleeps.stop("long")
    assert fit.ended.wait(ENDS)
    assert time.monotonic() - begun < 10.0
    assert sleeps.joined("long") is None
    assert answers == []
    sleeps.stop("long")


def test_nobody_waits_for_ever(monkeypatch):
    monkeypatch.setattr(background_fits, "FORGOTTEN", 0.2)
    fit = Fits(time.sleep).begun("long", 1000.0, print)
    assert fit.ended.wait(ENDS)


def test_so_many_and_no_more():
    sleeps = Fits(time.sleep)
    keys = range(background_fits.MAX_FITS)
    for key in keys:
        sleeps.begun(key, 1000.0, print)
    with pytest.raises(JobRefused, match="being fitted"):
        sleeps.begun("one more", 0.0, print)
    for key in keys:
        sleeps.stop(key)
