import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.fixtures import refused

from fixel.calibration import PatternSearch
from fixel.errors import InvalidInput
from fixel.formats.space_file import dakota_from_text, load_dakota, read_space

# Appendix C.7 of the thesis (RPI), with what the printed page lost put back: underscores,
# minus signs, and the gaps in the bounds.
THESIS = """
# DAKOTA INPUT FILE - dakota_NGopt_PatternSearch.in
# This input file does optimization search on the dvc planar grasping simulation
# to calibrate simulation parameters

strategy,
    single_method
    tabular_graphics_data

method,
    coliny_pattern_search
    max_iterations = 10000
    max_function_evaluations = 20000
    solution_accuracy = 1e-6
    initial_delta = 0.5
    threshold_delta = 1e-6
    pattern_basis coordinate
    exploratory_moves basic_pattern
    contraction_factor = 0.9

model,
    single

variables,
    continuous_design = 4
    initial_point 0.2 0.2 25 0.25
    lower_bounds 0 0 0 0
    upper_bounds 1 1 60 1
    descriptors 'fC' 'pCFC' 'sPRD' 'sFC'

interface,
    fork
    analysis_driver = 'simulator_script'
    parameters_file = 'params.in'
    results_file = 'results.out'
    file_tag
#   file_save

responses,
    num_objective_functions = 1
    no_gradients
    no_hessians
"""


def test_the_thesis_file_is_our_default_search_but_follows_every_decrease():
    optimiser, space, _ = dakota_from_text(THESIS)
    assert optimiser == PatternSearch(resolution=0.0)
    assert space.labels == ("mu_fixel", "mu_pusher", "tripod_radius", "mu_support")
    assert space.nominal == pytest.approx([0.2, 0.2, 0.025, 0.25])
    assert space.low == pytest.approx([0.0] * 4)
    assert space.high == pytest.approx([1.0, 1.0, 0.06, 1.0])
    # First steps of 0.05 for each friction and 3 mm for the radius.
    assert optimiser.initial_delta * space.scale == pytest.approx([0.05, 0.05, 0.003, 0.05])


def test_skipped_blocks_and_defaults_are_noted():
    notes = "\n".join(dakota_from_text(THESIS)[2])
    for block in ("strategy", "interface", "responses"):
        assert f"the block {block} was skipped" in notes
    assert "expand_after_success 5" in notes
    assert "initial_delta" not in notes


def test_newer_and_older_spellings():
    text = THESIS.replace("threshold_delta", "variable_tolerance")
    text = text.replace("solution_accuracy", "solution_target").replace("strategy", "environment")
    for word in ("initial_point", "lower_bounds", "upper_bounds", "descriptors"):
        text = text.replace(f"    {word}", f"    cdv_{word}")
    text = text.replace("'", '"').replace("0 0 0 0", "4 * 0").replace("1 1 60", "2*1 6.E+1,")
    assert dakota_from_text(text)[:2] == dakota_from_text(THESIS)[:2]


@pytest.mark.parametrize("changes", [
    {"'results.out'": "'results.out’", "'fC'": "‘fC’"},  # quotes copied from a page
    {"'sPRD'": "'tripod_radius'", " 25 ": " 0.025 ", "1 1 60 1": "1 1 0.06 1"},  # our units
])  # fmt: skip
def test_other_quotes_and_our_own_names_are_the_same_space(changes):
    text = THESIS
    for old, new in changes.items():
        text = text.replace(old, new)
    assert text != THESIS
    assert dakota_from_text(text)[1] == dakota_from_text(THESIS)[1]


def test_no_expansion():
    text = THESIS.replace("initial_delta", "no_expansion\n    initial_delta")
    assert dakota_from_text(text)[0] == PatternSearch(expand_after=None, resolution=0.0)


def test_what_is_left_out_is_as_dakota_has_it():
    text = "method coliny_pattern_search\n" + THESIS[THESIS.index("variables") :]
    optimiser, _, notes = dakota_from_text(text)
    assert optimiser == PatternSearch(
        initial_delta=1.0, threshold_delta=1e-5, contraction_factor=0.5, resolution=0.0,
        solution_accuracy=None, max_iterations=100, max_function_evaluations=1000,
    )  # fmt: skip
    assert "initial_delta 1" in notes[-1]


@pytest.mark.parametrize(("old", "new", "message"), [
    ("initial_delta =", "inital_delta =", r"line 15: found inital_delta, .*did you mean 'initi"),
    ("coliny_pattern_search", "coliny_ea",
     r"line 11: found coliny_ea, but fixel needs one of coliny"),
    ("method,", "methods,", r"dakota: found no method block"),
    ("strategy,", "strategies,", r"line 6: found strategies, .*did you mean 'strategy"),
    ("basic_pattern", "adaptive_pattern", r"line 18: found adaptive_pattern, but fixel needs expl"),
    ("coordinate", "simplex", r"line 17: found simplex, but fixel needs pattern_basis to be coord"),
    ("0.9", "", r"line 21: found model, but fixel needs a number after contraction_factor"),
    ("0.9", "0.9 0.8", r"fixel needs a number after contraction_factor"),
    ("0.9", "1.9", r"line 11\.PatternSearch\.contraction_factor is 1\.9"),
    ("= 10000", "= 10.5", r"line 12: .*a whole number after max_iterations"),
    ("= 10000", "= 1\n  max_iterations = 2", r"line 13: .*each keyword once"),
    ("single\n\nvar", "surrogate global\n\nvar", r"line 22: found surrogate"),
    ("continuous_design = 4", "continuous_design = 3", r"line 26: found 4 after initial_point"),
    ("'sFC'", "'sFC2'", r"line 29: found 'sFC2', .*did you mean 'sFC'"),
    ("'sFC'", "'fC'", r"found mu_fixel twice"),
    ("1 1 60 1", "1 0 60 1", r"line 25\.mu_pusher: found bounds 0 to 0"),
    ("0.2 0.2 25", "0.2 1.2 25", r"line 25\.mu_pusher\.start: .*move the start"),
    ("    upper_bounds 1 1 60 1\n", "", r"line 24: found variables without upper_bounds"),
    ("1 1 60 1", "1 1 inf 1", r"line 28: found inf, but fixel needs a finite number"),
    ("0 0 0 0", "0 0 0 -Inf", r"line 27: found -Inf, but fixel needs a finite number"),
    ("0 0 0 0", "0.5*0", r"a count before"),
    ("responses,", "method, coliny_pattern_search responses,", r"one method block"),
])  # fmt: skip
def test_refusals_name_the_line(old, new, message):
    assert old in THESIS
    refused(dakota_from_text, THESIS.replace(old, new, 1), match=message)


@pytest.mark.parametrize("text", ["", "method coliny_pattern_search", "variables", "# nothing"])
def test_parts_of_a_file(text):
    refused(dakota_from_text, text)


@given(st.data())
def test_any_text_is_read_or_refused(data):
    words = st.sampled_from([*THESIS.split(), "*", "'", "-1e999", "9*", "é", "\n"])
    text = " ".join(data.draw(st.lists(words, max_size=30)))
    cut = data.draw(st.integers(0, len(THESIS)))
    try:
        optimiser, space, _ = dakota_from_text(THESIS[:cut] + text + THESIS[cut:])
    except InvalidInput:
        return
    assert np.isfinite(space.scale).all()
    assert math.isfinite(optimiser.initial_delta)


def test_files(tmp_path):
    path = tmp_path / "search.in"
    path.write_text(THESIS, encoding="utf-8")
    assert load_dakota(path) == dakota_from_text(THESIS)
    refused(load_dakota, tmp_path / "missing.in", match="no such file")
    path.write_bytes(b"\xff\xfe method")
    refused(load_dakota, path, match="fixel needs a text file")
    refused(load_dakota, tmp_path)


def test_a_space_file(tmp_path):
    file = tmp_path / "space.yaml"
    file.write_text(
        "mu_pusher: {low: 0, high: 1, start: 0.2}\n"
        "tripod_radius_mm: {low: 10, high: 60, start: 40, prior: 5}\n"
        "mu_fixel: {low: 0, high: 1, start: 0.2, frozen: true}\n"
        "mu_support:\n"
        "  - {low: 0, high: 1, start: 0.2, where: {surface: abs}}\n"
        "  - {low: 0, high: 1, start: 0.3}\n"
    )
    space = read_space(file)
    assert space.labels == ("mu_pusher", "tripod_radius", "mu_support[surface=abs]", "mu_support")
    assert space.free[1].prior == pytest.approx(5e-3)


@pytest.mark.parametrize(("content", "said"), [
    ("[1, 2]", "no parameters"),
    ("mu_pusher: 3", "low, high, start"),
    ("mu_pusher: {low: 0, high: 1}", "space.yaml: mu_pusher.start is missing"),
    ("mu_pusher: {low: , high: 1, start: 0.2}", "mu_pusher.low is missing"),
    ("mu_pusher: {low: 0, high: 1, start: 2}", "outside the bounds"),
    ("mu_pusher: {low: 0, high: x, start: 0.2}", "mu_pusher.high is 'x'"),
    ("mu_pusher: {low: 0, high: 1, start: 0.2, frozen: no}", "mu_pusher.frozen is 'no'"),
    ("mu_pushr: {low: 0, high: 1, start: 0.2}", "did you mean 'mu_pusher'"),
])  # fmt: skip
def test_space_files_that_cannot_be(tmp_path, content, said):
    file = tmp_path / "space.yaml"
    file.write_text(content)
    refused(read_space, file, match=said)
