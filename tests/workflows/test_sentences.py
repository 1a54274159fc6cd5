"""Sentences of reports, from their templates."""

import jinja2
import pytest

from fixel.workflows.sentences import environment, rounded, sentences

NUMBERS = {"n": 3, "simulated": 1, "few": 10, "left_out": 2}


def test_every_item_of_a_block_is_a_sentence_on_one_line():
    some = sentences("data", "warnings", **NUMBERS)
    assert len(some) == 3
    assert some[0].startswith("1 of the experiments is simulated. They test the method")
    assert some[1].startswith("Only 3 experiments: other")
    assert all("\n" not in one and "  " not in one and one.endswith(".") for one in some)


def test_numbers_agree_with_their_nouns_and_verbs():
    (many,) = sentences("data", "methods", n=3, simulated=1, version="1")
    (one,) = sentences("data", "methods", n=1, simulated=0, version="1")
    assert many.startswith("3 real and simulated experiments were simulated with")
    assert one.startswith("1 recorded experiment was simulated with")
    (left,) = sentences("data", "warnings", n=20, simulated=0, few=10, left_out=1)
    assert left.startswith("1 experiment of the project with faults in the data was skipped; fixel")


def test_what_does_not_apply_is_left_out():
    assert sentences("data", "warnings", n=20, simulated=0, few=10, left_out=0) == ()
    (only,) = sentences("data", "warnings", n=1, simulated=0, few=10, left_out=0)
    assert only.startswith("Only 1 experiment: ")


def test_a_missing_value_is_an_error():
    with pytest.raises(jinja2.UndefinedError, match="left_out"):
        sentences("data", "warnings", n=20, simulated=0, few=10)


def test_skipped_pushes_make_one_warning():
    skipped = {f"lab/{k}": f"found no scene {k}" for k in range(20)}
    many = sentences("sensitivity", "warnings", found=(), skipped=skipped)
    assert many == ("lab/0 and 19 more were skipped: found no scene 0",)
    one = sentences("sensitivity", "warnings", found=(), skipped={"lab/0": "found no scene 0"})
    assert one == ("lab/0 was skipped: found no scene 0",)
    assert sentences("sensitivity", "warnings", found=(), skipped={}) == ()


def test_every_template_can_be_read():
    names = environment().list_templates()
    assert {"report.html", "report.css", "domain.txt", "growth.txt"} <= set(names)
    for name in names:
        assert environment().get_template(name)


def test_the_rounding_of_simulations_is_no_number():
    assert rounded(1.2e-13) == "0"
    assert rounded(-3e-9, 4) == "0"
    assert rounded(0.20584, 4) == "0.2058"
