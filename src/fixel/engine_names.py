"""Names of other engines, as users write them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from types import MappingProxyType
from typing import Final, NamedTuple


class BuiltIn(NamedTuple):
    """Place of the class of an engine, and the package that it needs."""

    module: str
    name: str
    package: str
    imported: str  # name of the package in Python
    tested: str  # front of the versions with which the conformance suite was run
    extra: str


ENGINES: Final[Mapping[str, BuiltIn]] = MappingProxyType(
    {
        "box2d": BuiltIn("box2d", "Box2D", "Box2D", "Box2D", "2.3", "engines"),
        "drake": BuiltIn("drake", "Drake", "drake", "pydrake", "1.51", "drake"),
        "mujoco": BuiltIn("mujoco", "MuJoCo", "mujoco", "mujoco", "4.0", "engines"),
        "pymunk": BuiltIn("chipmunk", "Chipmunk", "pymunk", "pymunk", "7.3", "engines"),
    }
)
GROUP = "fixel.engines"  # entry points of packages that offer an engine


class EngineName(NamedTuple):
    """Name of an engine as a user writes it, such as ``"mujoco==4.0.0:step=0.001"``."""

    name: str  # name of an engine, or path of a program
    version: str  # version that it must have; empty for any
    choices: str  # choices of the engine; empty for the usual ones

    @classmethod
    def of(cls, text: str) -> EngineName:
        """Return the parts of a name."""
        front, _, choices = text.partition(":")
        name, _, wanted = front.partition("==")
        return cls(name, wanted, choices)

    def __str__(self) -> str:
        wanted = f"=={self.version}" if self.version else ""
        return f"{self.name}{wanted}" + (f":{self.choices}" if self.choices else "")

    def fits(self, stated: str) -> bool:
        """Return whether a stated name has this name, and the version and choices given here."""
        other = EngineName.of(stated)
        return all(own in ("", found) for own, found in zip(self, other, strict=True))

    @property
    def short(self) -> str:
        """Name for texts: a program without its folder."""
        return str(self._replace(name=self.name.replace("\\", "/").rpartition("/")[2]))

    @property
    def is_program(self) -> bool:
        """Whether the name is the path of a program."""
        return "/" in self.name or "\\" in self.name


def is_engine(text: str) -> bool:
    """Return whether a name is that of another engine or of a program."""
    own = EngineName.of(text)
    return own.is_program or own.name in engine_names()


def engine_names() -> list[str]:
    """Return the names of all known engines, installed or not."""
    return [*ENGINES, *sorted(_offered())]


def motion_words(motion: str) -> list[str]:
    """Return the words of a command that choose a motion model, or an engine."""
    return ["--engine" if is_engine(motion) else "--motion", motion]


def compare_words(key: str, values: Mapping[str, float], motion: str) -> list[str]:
    """Return the words of the command that compares an experiment with its simulation."""
    settings = [word for k, v in values.items() for word in ("--set", f"{k}={v:.4g}")]
    return ["compare", key, *settings, *([] if motion == "dynamic" else motion_words(motion))]


def installed_engines() -> list[str]:
    """Return the names of the engines whose packages are installed."""
    known = [name for name, own in ENGINES.items() if find_spec(own.imported) is not None]
    return [*known, *sorted(_offered())]


@cache  # it reads the metadata of all packages, which takes 10 ms
def _offered() -> frozenset[str]:
    """Return the names of the engines that installed packages offer."""
    return frozenset(entry_points(group=GROUP).names)
