"""Maps of made-up errors: right where the truth is known, never trusted without evidence."""

import math

import numpy as np
import pytest
from tests.domain.worlds import STEPS, evidence_of, line, scattered
from tests.fixtures import refused

from fixel.domain.cells import axis_of, cells_of
from fixel.domain.claim import COLOURS, DOUBTFUL, NO_DATA, NOT_TRUSTED, PREDICTED, TRUSTED, Claim
from fixel.domain.domain import default_threshold, domain_map
from fixel.domain.evidence import default_folds, folds_of, threshold_score, value_of

VALLEY = 0.5 * np.exp(2.5 * np.abs(STEPS) / 0.04)  # 0.5 mm in the middle, 6 mm at the ends


def mapped(evidence, axes=("offset_y_m",), **settings):
    return domain_map(evidence, cells_of(evidence, axes), **settings)


def colours(domain, claim):
    return [[verdict.colour for verdict in own] for own in domain.verdicts(claim)]


def test_at_least_95_percent_of_decided_cells_are_right():
    right = decided = known = 0
    for seed in range(4):
        evidence, truth = scattered(members=3, seed=seed)
        domain = mapped(evidence)
        for threshold in (1.5, 2.0, 3.0, 5.0):
            said = np.array(colours(domain, Claim(threshold=threshold)))
            sure = np.isin(said, (TRUSTED, NOT_TRUSTED))
            right += int((sure & ((said == TRUSTED) == (truth <= threshold))).sum())
            decided += int(sure.sum())
            known += truth.size
    assert right / decided >= 0.95
    assert decided / known >= 0.6


def test_more_members_decide_more_cells():
    shares = []
    for members in (1, 4):
        evidence, _ = scattered(members=members, seed=5)
        said = np.array(colours(mapped(evidence), Claim(threshold=2.5)))
        shares.append(np.isin(said, (TRUSTED, NOT_TRUSTED)).mean())
    assert shares[1] > shares[0]


def test_the_domain_is_what_hangs_together_about_the_nominal():
    errors = VALLEY.copy()
    errors[8] = 30.0  # beyond it lies a part that is below, but apart
    errors[9:] = 0.5
    domain = mapped(line(errors, repetitions=25))
    claim = Claim(threshold=2.0)
    (inside,) = domain.domains(claim)
    assert inside == [3, 4, 5, 6, 7]
    assert colours(domain, claim)[0][9] == TRUSTED
    assert domain.extents(claim) == [{"offset_y_m": ("-16", "16")}]


def test_counting_decides_where_members_are_enough():
    claim = Claim(threshold=1.0)
    assert claim.needed == 28
    assert 1.0 - claim.level ** (claim.needed + 1) >= claim.confidence
    good = np.full(11 * claim.needed, 0.9)
    domain = mapped(line(good, repetitions=claim.needed))
    assert {colour for own in colours(domain, claim) for colour in own} == {TRUSTED}
    assert domain.confidence(claim) == pytest.approx(np.full((1, 11), 1.0 - 0.9**29))
    bad = good.copy()
    bad[: claim.needed // 4] = 5.0  # a quarter of the first cell
    assert colours(mapped(line(bad, repetitions=claim.needed)), claim)[0][0] == NOT_TRUSTED


def test_no_cell_is_trusted_without_experiments_of_its_own():
    evidence = line(np.full(11, 0.1)).rows([0, 1, 2, 4, 5, 6, 8, 9])
    steps = evidence.column("offset_y_m") + tuple(STEPS)
    both = evidence_of(
        np.full(19, 0.1), {"offset_y_m": steps}, group=("one",) * 8 + ("other",) * 11
    )
    domain = mapped(both)
    first, second = colours(domain, Claim(threshold=100.0))
    assert [k for k, colour in enumerate(first) if colour == NO_DATA] == [3, 7, 10]
    assert NO_DATA not in second
    assert math.isnan(domain.confidence(Claim(threshold=100.0))[0, 3])
    bound = np.full((2, 11), np.nan)
    bound[0, 3], bound[0, 7] = 50.0, 500.0
    hatched = mapped(both, predicted_mm=bound)
    said = colours(hatched, Claim(threshold=100.0))[0]
    assert said[3] == PREDICTED
    assert said[7] == NO_DATA
    assert 3 not in hatched.domains(Claim(threshold=100.0))[0]


def test_a_failed_simulation_is_above_every_threshold():
    errors = np.full(11, 0.5)
    errors[4] = np.inf
    claim = Claim(threshold=50.0)
    assert colours(mapped(line(errors)), claim)[0][4] in (NOT_TRUSTED, DOUBTFUL)
    assert np.isinf(mapped(line(errors)).statistic(0.9)[0, 4])


def test_the_domain_grows_with_the_threshold():
    domain = mapped(line(VALLEY, repetitions=3))
    claim = Claim(threshold=1.0)
    taus = domain.usual_thresholds
    (sizes,) = domain.curve(claim, taus.tolist())
    assert (np.diff(taus) > 0.0).all()
    assert sizes[0] < sizes[-1] == 11.0
    assert (np.diff(sizes) >= 0.0).all()


def test_the_same_seed_gives_the_same_bits():
    evidence, _ = scattered(maps=2)
    one, other = (mapped(evidence).confidence(Claim(threshold=2.0)) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_relative_errors_are_held_against_an_own_best():
    own = np.full(11, 1.0)
    own[0] = np.nan
    evidence = line(np.sqrt(np.full(11, 3.0)), own_mm2=own)
    scores = evidence.scores("relative")
    assert math.isnan(scores[0])
    assert value_of(float(scores[1]), "relative") == pytest.approx(2.0)
    domain = mapped(evidence, measure="relative")
    said = colours(domain, Claim(threshold=9.0, measure="relative"))[0]
    assert said[0] == NO_DATA
    assert set(said[1:]) == {TRUSTED}
    assert threshold_score(1.0, "relative") == pytest.approx(math.log(2.0))


def test_what_would_teach_most_is_open_and_near():
    domain = mapped(line(VALLEY))
    claim = Claim(threshold=2.0)
    found = domain.proposals(claim)
    said = colours(domain, claim)[0]
    assert found
    assert [one.bits for one in found] == sorted((one.bits for one in found), reverse=True)
    assert found[0].bits > 0.0
    assert all(said[one.cell] in (DOUBTFUL, NO_DATA) for one in found)
    assert "offset_y = " in found[0].where
    assert found[0].where.endswith("mm")


def test_too_few_experiments_are_refused_with_how_many_are_needed():
    refused(mapped, line(VALLEY).rows([0, 1, 2]), match="at least 6")
    refused(Claim, threshold=1.0, confidence=0.4, match="confidence")
    refused(Claim, threshold=0.0, match="positive")


def test_the_usual_threshold_is_twice_the_median():
    assert default_threshold(line(np.full(11, 1.234))) == 2.5


# --- cells --------------------------------------------------------------------------------------


def test_few_values_are_cells_and_many_become_ranges():
    assert axis_of("offset_y_m", STEPS.tolist()).centres == pytest.approx(STEPS)
    many = axis_of("push_angle_rad", np.linspace(0.0, 1.0, 200).tolist())
    assert len(many) == 8
    assert np.bincount(many.find(np.linspace(0.0, 1.0, 200).tolist())).min() >= 24
    wide = axis_of("offset_y_m", STEPS.tolist(), step=0.02)
    assert wide.text(0) == "-50 to -30"
    assert wide.find([0.0]).tolist() == [len(wide) // 2]
    text = axis_of("surface", ["plywood", "abs", None, "abs"])
    assert text.labels == ("abs", "plywood")
    assert text.find(["abs", None, "felt"]).tolist() == [0, -1, -1]


def _plane(points):
    x, y = np.transpose(points)
    return evidence_of(np.ones(len(points)), {"offset_x_m": x, "offset_y_m": y})


def test_offsets_one_at_a_time_are_arms_and_a_grid_is_a_grid():
    names = ("offset_x_m", "offset_y_m")
    cross = cells_of(_plane([(0.0, 0.0), (0.01, 0.0), (0.0, 0.01), (0.0, -0.01)]), names)
    assert cross.arms
    assert len(cross) == 4
    assert cross.text(cross.nominal) == "offset_x = 0 mm, offset_y = 0 mm"
    assert sorted(cross.component([True] * 4)) == [0, 1, 2, 3]
    grid = cells_of(_plane([(x, y) for x in (0.0, 0.01) for y in (0.0, 0.01, 0.02)]), names)
    assert not grid.arms
    assert len(grid) == 6
    assert len(grid.edges) == 7


def test_axes_and_nominals_that_cannot_be_are_refused():
    evidence = _plane([(0.0, 0.0), (0.01, 0.01)])
    refused(cells_of, evidence, ("offset_z_m",), match="one of offset_x_m")
    refused(cells_of, evidence, ("offset_x_m", "offset_x_m"), match="each axis once")
    refused(cells_of, evidence, ("offset_x_m",), {"offset_x_m": 0.5}, match="with experiments")
    refused(cells_of, evidence, ("offset_x_m",), {"offset_y_m": 0.0}, match="one of offset_x_m")
    refused(
        cells_of,
        evidence,
        ("offset_x_m",),
        {},
        {"offset_y": 1e-3},
        match="^cells.*one of offset_x_m",
    )


# --- folds --------------------------------------------------------------------------------------


def test_repetitions_are_held_out_together_and_groups_spread():
    blocks = [f"{g}{k}" for g in "ab" for k in range(10) for _ in range(2)]
    strata = [block[0] for block in blocks]
    fold = folds_of(blocks, strata, 5, seed=3)
    assert all(len({int(fold[k]) for k, b in enumerate(blocks) if b == x}) == 1 for x in blocks)
    for stratum in "ab":
        own = [int(f) for f, s in zip(fold, strata, strict=True) if s == stratum]
        assert np.bincount(own).tolist() == [4] * 5
    np.testing.assert_array_equal(fold, folds_of(blocks, strata, 5, seed=3))
    assert default_folds(420) == 5
    assert default_folds(4774) == 2


def test_fewer_configurations_than_folds_are_refused():
    refused(folds_of, ["a", "a", "b"], ["", "", ""], 5, match="at least 5")


def test_colours_all_differ():
    assert len(set(COLOURS)) == 5


def test_cells_are_trusted_only_where_other_experiments_confirm_it():
    """One error in five is four times as large, in every cell: cells look good by chance only."""
    rng = np.random.default_rng(0)
    claim, steps, n_map = Claim(threshold=3.0), np.tile(STEPS, 8), 8

    def errors(n):
        return np.where(rng.random(n) < 0.2, 4.8, 1.2)

    group = tuple(f"map {g}" for g in range(n_map) for _ in range(len(STEPS) * 6))
    domain = mapped(line(errors(6 * len(steps)), steps, repetitions=6, group=group))
    stated = (domain.statistic(claim.level) <= 3.0) & (domain.confidence(claim) >= 0.95)
    kept = np.array(colours(domain, claim)) == TRUSTED
    assert stated.sum() >= 10  # all of them by chance
    assert kept.sum() <= 0.3 * stated.sum()
    assert (stated | ~kept).all()
    # Where errors are alike, nothing is taken away.
    fine = mapped(line(1.0 + 0.2 * rng.random(6 * len(steps)), steps, repetitions=6, group=group))
    assert fine.required_confidence(claim) == claim.confidence
    assert (np.array(colours(fine, claim)) == TRUSTED).all()
