"""Loop of a program that offers an engine of this package, or a user's, as lines of JSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from fixel.simulation.engines.contract import AbstractPhysicsEngine
from fixel.simulation.engines.scripts.drive import EngineFailed
from fixel.simulation.engines.task import task_from


def serve(engine: AbstractPhysicsEngine) -> None:
    """Answer the questions on standard input until it ends.

    Standard output is for answers only: what the engine prints goes to standard error.

    Parameters
    ----------
    engine : AbstractPhysicsEngine

    Examples
    --------
    A program of a user, which fixel runs as ``--engine ./mine.py``::

        from fixel.simulation.engines import AbstractPhysicsEngine, serve

        class Mine(AbstractPhysicsEngine):
            ...

        serve(Mine())
    """
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    for line in sys.stdin:
        answers.write(json.dumps(answer(engine, json.loads(line))) + "\n")


def answer(engine: AbstractPhysicsEngine, question: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer of an engine to one question."""
    if "hello" in question:
        info = engine.info()
        parameters = {
            name: {**own._asdict(), "lowest": max(own.lowest, -sys.float_info.max)}
            for name, own in info.parameters.items()
        }
        return {"name": info.name, "version": info.version, "parameters": parameters}
    task = task_from(question["task"])
    refusal = engine.refusal(task)
    if refusal:
        return {"refused": refusal}
    try:
        return {"pose": engine.under(task.values).answer(task).tolist()}
    except EngineFailed as failure:
        return {"failed": str(failure)}


if __name__ == "__main__":
    serve(import_module("fixel.simulation.engines").engine_of(sys.argv[1]))
