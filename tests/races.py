"""Races between plans whose margins are known."""

from fixel.calibration.study import run_study
from fixel.planning.race import race_rounds


def race(evaluate, n_plans, **options):
    """Run a race with margins (m, k) from `evaluate(plans, scenarios)`."""
    return run_study(race_rounds(n_plans, **options), lambda wanted: evaluate(*wanted))
