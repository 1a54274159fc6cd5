"""Command that repeats a domain map."""

from __future__ import annotations

import shlex
from pathlib import Path

from fixel.domain.domain import Claim
from fixel.workflows.domain.request import DomainRequest


def command_of(folder: Path, asked: DomainRequest, claim: Claim) -> str:
    """Return the command that repeats a map.

    Parameters
    ----------
    folder : Path
        Folder of the project; left out of the command if it is the current folder.
    asked : DomainRequest
    claim : Claim
        Claim that replaces the requested one.
    """
    words = ["fixel", "domain"]
    words += [] if folder == Path() else ["--project", str(folder)]
    if asked.query.dataset:
        words += ["--dataset", asked.query.dataset]
    for name, relation, value in asked.query.conditions:
        words += ["--where", f"{name}{relation}{value}"]
    words += ["--all"] * asked.query.include_faulty
    if asked.calibration is not None:
        words += ["--calibration", str(asked.calibration)]
    for setting in asked.fit:
        words += ["--fit", setting]
    for option, names in (("--axes", asked.axes), ("--by", asked.by), ("--apart", asked.apart)):
        words += [option, ",".join(names)] if names else []
    words += ["--leave-out", asked.leave_out] if asked.leave_out else []
    if asked.nominal:
        words += ["--nominal", ",".join(f"{k}={v}" for k, v in asked.nominal.items())]
    for name, width in asked.steps.items():
        words += ["--step", f"{name}={width}"]
    option = "--threshold-mm" if claim.measure == "absolute" else "--relative"
    words += [option, f"{claim.threshold:.4g}"]
    for name in ("level", "confidence"):
        value = getattr(claim, name)
        words += [] if value == getattr(DomainRequest(), name) else [f"--{name}", f"{value:g}"]
    words += ["--folds", str(asked.folds)] if asked.folds else []
    words += ["--seed", str(asked.seed)] if asked.seed else []
    return shlex.join(words)
