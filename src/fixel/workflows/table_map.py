"""Map an uneven table from pushes of parts on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fixel.calibration.known_pushes import PARTS, SURFACES
from fixel.errors import InvalidInput
from fixel.io.array_bytes import ResultCache
from fixel.model import Experiment
from fixel.parts.fit import NAMES
from fixel.parts.model import PartModel
from fixel.parts.table_map import TableMap, by_part, fitted_map
from fixel.progress import ProgressOption, show_progress
from fixel.workflows.parts import condition_of, fitted_values

if TYPE_CHECKING:
    from fixel.workflows.calibration.calibration import Calibration


def table_map(
    experiments: Iterable[Experiment],
    calibrations: Mapping[str, Mapping[str, float] | Calibration] | PartModel | None = None,
    *,
    part: str | None = None,
    surface: str | None = None,
    threads: int | None = None,
    store: str | Path | None = None,
    progress: ProgressOption = None,
) -> TableMap:
    """Map the unevenness of a table from pushes of one or several parts on it.

    The same push ends elsewhere when it is made at another place or orientation, because no table
    is flat. The map says where parts press more. It is judged by leaving out whole parts, or the
    sides of fewer than three parts, and has weight 0 where it does not help.

    Parameters
    ----------
    experiments : sequence of Experiment
        Pushes on one table of single parts by a round pusher, slow enough to be quasi-static.
        Experiments without a scene are left out.
    calibrations : mapping of str to Calibration, or PartModel, optional
        Calibrated values of each part by its name, or a model that has fitted the parts. By default
        the twelve values of `fixel.part_model` are fitted to each.
    part : str, optional
        Condition that names the part; by default the first of `shape`, `part`, `object` and
        `object_id` that the experiments have.
    surface : str, optional
        Condition that names the table; by default the first of `surface` and `table`.
    threads : int, optional
        Number of threads; all cores by default. Results are the same for any number.
    store : path, optional
        Folder for finished fits, so that an interrupted call continues.
    progress : bool or callable, optional
        See `fixel.progress.show_progress`.

    Returns
    -------
    TableMap
        `.on(scene)` puts the table into a scene or an experiment; `.moved(experiments)` tells
        whether it has moved since.

    Raises
    ------
    InvalidInput
        The experiments are of several tables, none has a scene, a part has no calibration, or a
        part stands on three points, which press the same on every table.

    References
    ----------
    :cite:t:`rasmussen2006` for the prior of the map.

    Examples
    --------
    >>> from fixel.testing.pushes import example_parts
    >>> table = table_map(example_parts(3, 8, uneven=0.8), progress=False)
    >>> table.name, table.frame
    ('board', ('example',))
    """
    used = tuple(own for own in experiments if own.scene is not None)
    if not used:
        raise InvalidInput("experiments", found="none with a scene", expected="pushes of parts")
    part = part or condition_of(used, PARTS, "part")
    surface = surface or condition_of(used, SURFACES, "")
    names = sorted({str(own.conditions.get(surface, "")) for own in used})
    if len(names) > 1:
        raise InvalidInput(
            "experiments",
            found=f"{surface}={' and '.join(names)}",
            expected="experiments on one table",
            hint="make a map of each",
        )
    groups = by_part(used, part, threads)
    cache = ResultCache(None if store is None else Path(store))
    values = {}
    with show_progress(progress, "fitting parts") as report:
        for done, (name, group) in enumerate(groups.items()):
            if calibrations is None:
                found = fitted_values(group, 0, cache, f"{names[0]}_{name}")
                values[name] = dict(zip(NAMES, found.tolist(), strict=True))
            else:
                values[name] = _values(calibrations, name, names[0], group.targets[0].conditions)
            report(done + 1, len(groups), name)
    with show_progress(progress, "differentiating pushes") as report:
        found_map = fitted_map(groups, values, report)
    return TableMap(
        surface=surface,
        name=names[0],
        frame=tuple(sorted({own.dataset for own in used})),
        part=part,
        values=values,
        experiments=tuple(own.key for own in used),
        **found_map._asdict(),
    )


def _values(
    calibrations: Mapping[str, Mapping[str, float] | Calibration] | PartModel,
    part: str,
    surface: str,
    conditions: Mapping[str, str | float],
) -> dict[str, float]:
    """Return the calibrated values of a part on a surface."""
    if isinstance(calibrations, PartModel):
        for own in calibrations.fits:
            if (own.part, own.surface) == (part, surface):
                return dict(zip(NAMES, own.values.tolist(), strict=True))
    elif part in calibrations:
        given = calibrations[part]
        found = given.values_for(**conditions) if hasattr(given, "values_for") else given
        return {name: float(value) for name, value in found.items()}
    raise InvalidInput(
        "calibrations", found=f"none of part {part!r}", expected="a calibration of every part"
    )
