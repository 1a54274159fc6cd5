"""Other simulators, which functions of fixel can use instead of its own engine."""

from __future__ import annotations

import atexit
import functools
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, entry_points, version

from fixel.engine_names import ENGINES, GROUP, EngineName
from fixel.errors import InvalidInput, MissingExtra, unknown_name
from fixel.simulation.engines.contract import AbstractPhysicsEngine, EngineInfo
from fixel.simulation.engines.program import Program, ProgramFailed
from fixel.simulation.engines.scripts.drive import EngineFailed
from fixel.simulation.engines.serve import serve
from fixel.simulation.engines.task import PlainTask
from fixel.trust import SERVE, command_of

__all__ = [
    "ENGINES",
    "AbstractPhysicsEngine",
    "EngineFailed",
    "EngineInfo",
    "EngineName",
    "PlainTask",
    "engine_of",
    "program_of",
    "serve",
    "shared_program",
]


def engine_of(text: str) -> AbstractPhysicsEngine:
    """Return an engine by its name; raise where its package is missing."""
    own = EngineName.of(text)
    if own.name in ENGINES:
        built_in = ENGINES[own.name]
        _check_installed(own)
        module = import_module(f"fixel.simulation.engines.{built_in.module}")
        made: type[AbstractPhysicsEngine] = getattr(module, built_in.name)
    else:
        found = entry_points(group=GROUP, name=own.name)
        if not found:
            raise unknown_name("engine", own.name, ENGINES, more=", or the path of a program")
        made = next(iter(found)).load()
    return made.of_text(own.choices)


def program_of(text: str) -> Program:
    """Return the program of an engine, not started yet; raise where it cannot be."""
    own = EngineName.of(text)
    if own.is_program:
        command = command_of(own)
        return Program((sys.executable, *command) if command[0].endswith(".py") else command)
    if own.name in ENGINES:
        _check_installed(own)
    return Program((*SERVE, str(own)))


@functools.lru_cache(maxsize=4)
def shared_program(text: str) -> Program:
    """Return the program of an engine that all callers in this process use, until it ends."""
    program = program_of(text)
    atexit.register(program.close)
    return program


def stated(text: str) -> str:
    """Return the name of an engine with its version, and of a program with its whole path."""
    own = EngineName.of(text)
    if own.is_program:
        own = own._replace(name=command_of(own)[0])
    program = program_of(str(own))
    try:
        found = program.info().version
    except ProgramFailed as failure:
        raise silent(own.name, failure) from None
    finally:
        program.close()
    return str(own._replace(version=own.version or found))


def silent(engine: str, failure: ProgramFailed) -> InvalidInput:
    """Return the refusal of an engine that does not answer."""
    expected = 'an answer to {"hello": 1}, such as {"name": "mine", "version": "1"}'
    return InvalidInput(f"engine {engine}", found=failure, expected=expected)


def _check_installed(own: EngineName) -> None:
    """Raise where the package of an engine is missing, or has a version that was not tested."""
    needed = ENGINES[own.name]
    try:
        found = version(needed.package)
    except PackageNotFoundError:
        raise MissingExtra(f"the engine {own.name}", needed.package, extra=needed.extra) from None
    if not own.version and not f"{found}.".startswith(f"{needed.tested}."):
        raise InvalidInput(
            f"engine {own.name}",
            found=f"version {found}",
            expected=f"version {needed.tested}, which was tested",
            hint=f"run pip install '{needed.package}=={needed.tested}.*', or use the version as it "
            f"is by the name {own._replace(version=found)}",
        )
