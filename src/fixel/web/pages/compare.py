"""Page that compares sets of parameters on one experiment; its address holds all of them."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fastapi import Request

from fixel.engine_names import installed_engines
from fixel.errors import FixelError, NotStored, number_of
from fixel.kernels.code_cache import share_compiled
from fixel.model.selection import ExperimentQuery
from fixel.simulation.first_code import ENTRY
from fixel.units import displayed
from fixel.web.views.live_comparison import (
    DYNAMIC,
    ComparedSimulation,
    ParameterSlider,
    StoredSet,
    calibrated_of,
    ready,
)
from fixel.web.views.motion_views import MotionView, animation_of_experiment

if TYPE_CHECKING:
    from fixel.web.context import ProjectContext

OFFERED: Final = 300  # names in the list of experiments
USUAL_SLIDERS: Final = 4
MAX_SHOWN: Final = 6  # sets with colours that differ clearly
MOTIONS: Final = (DYNAMIC, "quasistatic", "first-order")
PINNED: Final = "pinned-"
PATIENCE: Final = 2.0  # [s] until the page is shown without simulations
COMPILING: Final = "compiling the simulator, only once: {:.0f} % done"


class ShownSet(NamedTuple):
    """Row of the table of sets."""

    id: str
    label: str
    motion: str
    values: list[str]
    answer: ComparedSimulation | None
    problem: str


class ShownSlider(NamedTuple):
    """Slider in the unit for people."""

    known: ParameterSlider
    unit: str
    factor: float
    value: float
    on: bool

    @property
    def text(self) -> str:
        """Value in its field."""
        return f"{self.factor * self.value:.5g}"


def compare_page(context: ProjectContext, request: Request) -> dict[str, Any]:
    """Fill `/compare?experiment=KEY&set=ID&base=ID&motion=NAME&PARAMETER=VALUE`.

    Sliders start at the set `base`; values have their units. Buttons add `adopt`, `pin` or `drop`.
    """
    query, known = request.query_params, context.comparison
    key = query.get("experiment", "")
    # The list of experiments is no part that is exchanged while a slider moves.
    most = 0 if key and "x-fixel-parts" in request.headers else OFFERED
    listed = context.store.experiments(ExperimentQuery(limit=most)).rows if most else []
    if not key and not listed:
        raise NotStored("experiment to compare", hint="import some with: fixel import")
    number = context.store.find(key) if key else listed[0].id
    experiment = known.experiment(number)
    offered = {one.id: one for one in known.sets(number)}
    chosen = _chosen(query.getlist("set"), offered)
    base = offered["nominal"]
    if "base" not in query:  # what a calibration changed is what one looks for
        base = (calibrated := calibrated_of(offered.values())) or base
        chosen = [offered["nominal"], *([calibrated] if calibrated else [])]
    every = offered | {one.id: one for one in chosen}
    base = every.get(query.get("adopt") or query.get("base", ""), base)
    sliders = [
        _slider(one, base, {} if "adopt" in query else query, k < USUAL_SLIDERS)
        for k, one in enumerate(known.sliders(number))
    ]
    motion = base.motion if "adopt" in query else query.get("motion") or base.motion
    parameters = base.parameters | {
        one.known.name: one.value
        for one in sliders
        if one.value != base.parameters.get(one.known.name, one.known.nominal)
    }
    if "pin" in query:
        chosen.append(_pinned(parameters, motion, chosen))
    chosen = [one for one in chosen if one.id != query.get("drop")][: MAX_SHOWN - 1]
    adjusted = StoredSet(
        id="adjusted", label="adjusted", kind="nominal", parameters=parameters, motion=motion,
        error_mm2=None,
    )  # fmt: skip
    cold = not ready.wait(PATIENCE)
    rows = [_row(context, number, one, sliders, cold) for one in (adjusted, *chosen)]
    motions = _motions(rows)
    return {
        "title": f"Compare {experiment.key}",
        "number": number,
        "key": experiment.key,
        "keys": [row.key for row in listed],
        "offered": offered.values(),
        "base": base.id,
        "chosen": chosen,
        "full": len(rows) >= MAX_SHOWN,
        "rows": rows,
        "cold": cold,
        "drawn": [motion.id for motion in motions],
        "best": min((e for r in rows if r.answer and (e := r.answer.error_mm2)), default=None),
        "measured_mode": experiment.contact_mode,
        "sliders": sliders,
        "motion": motion,
        "motions": dict.fromkeys((*MOTIONS, *installed_engines(), motion)),
        "parameters": parameters,
        "unseen": dict.fromkeys(text for one in chosen for text in one.unseen),
        "story": animation_of_experiment(experiment, motions).model_dump_json(by_alias=True),
        "degrees": degrees(1),
    }


def judged(context: ProjectContext, number: int) -> dict[str, Any]:
    """Return the motion of an experiment with the simulations that it is judged by.

    These are nominal against calibrated values; without a calibration, the newest stored
    simulation, made again for its forces. One by the publisher of the data is shown, too.
    """
    known = context.comparison
    offered = known.sets(number)
    published = context.store.published_simulations().get(number)
    calibrated = calibrated_of(offered)
    if calibrated is not None:
        sets = [offered[0], calibrated]
    else:
        own = (
            one
            for one in offered
            if one.kind == "simulation" and one.id != f"simulation-{published}"
        )
        newest = next(own, offered[0].model_copy(update={"label": "simulated now"}))
        motion = newest.motion if newest.motion in MOTIONS else DYNAMIC
        sets = [newest.model_copy(update={"id": "simulated", "kind": "nominal", "motion": motion})]
    cold = not ready.wait(PATIENCE)
    rows = [_row(context, number, one, [], cold) for one in sets]
    motions = [] if published is None else [known.simulated(number, published)]
    first = len(motions) + 1
    motions += _motions(rows)
    return {
        "rows": [row for row in rows if row.answer],
        "first": first,
        "cold": cold,
        "problems": [
            p for row in rows if (p := row.problem or (row.answer and row.answer.motion.advice))
        ],
        "which": f"nominal against {calibrated.label}"
        if calibrated
        else ", ".join((rows[0].label, *(rows[0].values or ["nominal values"]))),
        "story": animation_of_experiment(known.experiment(number), motions).model_dump_json(
            by_alias=True
        ),
        "degrees": degrees(1),
    }


def _motions(rows: list[ShownSet]) -> list[MotionView]:
    return [
        row.answer.motion.model_copy(update={"id": row.id, "label": row.label})
        for row in rows
        if row.answer
    ]


def _chosen(ids: list[str], offered: Mapping[str, StoredSet]) -> list[StoredSet]:
    """Return the sets of an address; a pinned one is written there as a whole."""
    found: dict[str, StoredSet] = {}
    for text in ids:
        if text in offered:
            found[text] = offered[text]
        elif text.startswith(PINNED) and "|" in text:
            id_, motion, *values = text.split("|")
            pairs = (value.partition("=") for value in values)
            found[text] = StoredSet(
                id=text, label=f"set {id_.removeprefix(PINNED)}", kind="nominal", motion=motion,
                parameters={name: number_of(own, name) for name, _, own in pairs}, error_mm2=None,
            )  # fmt: skip
    return list(found.values())


def _pinned(parameters: Mapping[str, float], motion: str, chosen: list[StoredSet]) -> StoredSet:
    numbers = [int(n) for one in chosen if (n := one.label.removeprefix("set ")).isdecimal()]
    values = [f"{name}={value!r}" for name, value in parameters.items()]
    number = max(numbers, default=0) + 1
    id_ = "|".join((f"{PINNED}{number}", motion, *values))
    return _chosen([id_], {})[0]


def _slider(
    one: ParameterSlider, base: StoredSet, query: Mapping[str, str], usual: bool
) -> ShownSlider:
    """Return a slider at the value of the address; an unchanged value keeps all its digits."""
    unit, factor = displayed(one.unit)
    known = base.parameters.get(one.name, one.nominal)
    given = query.get(one.name, "")
    shown = ShownSlider(
        one, unit, factor, known, usual or bool(given) or one.name in base.parameters
    )
    if not given or given == shown.text:
        return shown
    return shown._replace(value=number_of(given, one.name) / factor)


def _row(
    context: ProjectContext, number: int, one: StoredSet, sliders: list[ShownSlider], cold: bool
) -> ShownSet:
    units = {own.known.name: (own.unit, own.factor) for own in sliders}
    values = []
    for name, value in one.parameters.items():
        unit, factor = units.get(name, ("", 1.0))
        values.append(f"{name} {factor * value:.4g} {unit}".strip())
    answer, problem = None, ""
    if cold:
        problem = COMPILING.format(100.0 * (share_compiled(ENTRY) or 0.0))
    try:
        if cold:
            pass
        elif one.kind == "simulation":
            stored = int(one.id.removeprefix("simulation-"))
            answer = context.comparison.stored(number, stored, context.folder)
        else:
            given = tuple(one.parameters.items())
            answer = context.comparison.repeated(number, given, one.motion, context.folder)
    except FixelError as error:
        problem = str(error)
    return ShownSet(one.id, one.label, one.motion, values, answer, problem)
