"""Options of a function, as its signature and its docstring state them."""

from __future__ import annotations

import inspect
import math
import operator
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Union, get_args, get_origin

from fixel.docstrings import meanings
from fixel.errors import InvalidInput, check_name, number_of

if TYPE_CHECKING:
    from fixel.calibration.noise import Noise
    from fixel.simulation.motion import AbstractMotionModel

# SI units in one unit that a door shows; the product is the value of the option.
FACTORS: Final[Mapping[str, float]] = {
    "mm": 1e-3, "mm/s": 1e-3, "mrad": 1e-3, "ms": 1e-3, "deg": math.pi / 180.0, "s": 1.0, "N": 1.0
}  # fmt: skip
# Limits [SI] at a door that states no others: of numbers above zero, with a unit, and of all.
SMALLEST, MAX_SIZE, MAX_NUMBER, MAX_INTEGER = 1e-9, 1e6, 1e12, 2**63 - 1
MAX_WORKERS: Final = 1000  # of one job
NONE: Final = "none"  # text of None in a mapping
_METAVARS: Final = {int: "INTEGER", float: "FLOAT", str: "TEXT", Path: "FILE"}
_YES: Final = ("yes", "no")


@dataclass(frozen=True, slots=True, kw_only=True)
class Door:
    """Annotation of an option for what its name and its type do not state."""

    # Flag of a command, `--uniform/--normal` for a bool; by default from name and unit.
    flag: str = ""
    # Other flags of the same option: a letter such as `-n`, or the name in earlier versions.
    also: tuple[str, ...] = ()
    # Meaning of an option that several capabilities share, unless the docstring states another.
    meaning: str = ""
    metavar: str = ""  # form of the value, such as `NAME=LOW:HIGH`
    usual: str = ""  # words for a default that is found when the command runs
    unit: str = ""  # unit at commands and pages; the value itself is in SI units
    plain: Any = None  # type in a request, for a parameter that also accepts objects in Python
    # Smallest and largest value, or bounds that are not allowed themselves, in SI units.
    least: float | None = None
    above: float | None = None
    most: float | None = None
    below: float | None = None
    # Raises `InvalidInput` for a value that can never be used, at the option or a part of it.
    check: Callable[[Any], object] | None = None
    # Returns all allowed texts, for choices that are registered elsewhere.
    among: Callable[[], Sequence[str]] | None = None
    effort: bool = False  # whether it changes the effort, but no result
    # Whether it is the name of a file or its content in JSON, which a page states.
    content: bool = False
    condition: bool = False  # whether it is the name of a condition of experiments
    commas: bool = False  # whether one text lists several values with commas between them
    writes: bool = False  # whether it is a file that the function writes
    # Whether it may name a program to run, which only a user at a command permits.
    program: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """Option of a capability."""

    name: str  # name of the argument; `group.field` for a field of a dataclass
    plain: Any  # annotated type in a request
    default: Any
    meaning: str  # sentences of the docstring or the annotation
    required: bool = False
    place: bool = False  # whether it is typed without a flag
    door: Door = field(init=False)
    kind: Any = field(init=False)  # the type without annotations and None

    def __post_init__(self) -> None:
        object.__setattr__(self, "door", door_of(self.plain))
        object.__setattr__(self, "kind", _bare(self.plain))

    @property
    def many(self) -> bool:
        """Whether the option may be repeated."""
        return get_origin(self.kind) in (dict, Mapping) or get_args(self.kind)[1:] == (...,)

    @property
    def flag_words(self) -> str:
        """Flag of the command as Typer reads it, `--this/--no-this` for a bool."""
        group, unit = self.name.partition(".")[0], self.door.unit
        usual = f"--{group}{f'-{unit}' if unit else ''}".replace("_", "-").replace("/", "-")
        if self.kind is bool:
            usual = f"{usual}/--no-{usual[2:]}"
        return self.door.flag or usual

    @property
    def flag(self) -> str:
        """Name of the option in errors of the command."""
        return self.flag_words.partition("/")[0]

    @property
    def label(self) -> str:
        """Name of the option on a page, with its unit."""
        words = self.name.partition(".")[0].replace("_", " ")
        return f"{words} [{self.door.unit}]" if self.door.unit else words

    @property
    def help(self) -> str:
        """Meaning with the unit of the door instead of that of Python."""
        unit = self.door.unit
        return re.sub(r"\[(m|rad|s|kg)\]", f"[{unit}]", self.meaning) if unit else self.meaning

    @property
    def metavar(self) -> str:
        """Form of the value."""
        return self.door.metavar or _metavar(self.kind)

    @property
    def on_page(self) -> bool:
        """Whether a page may set the option: no file of the server, and results are stored."""
        return self.kind is not Path and self.name != "save"

    @property
    def choices(self) -> tuple[str, ...]:
        """Texts of all values, where there are few."""
        texts = get_args(self.kind) if get_origin(self.kind) is Literal else ()
        return tuple(self.door.among()) if self.door.among else _YES if self.kind is bool else texts

    def check(self, value: Any, where: str = "") -> None:
        """Raise `InvalidInput` for a value outside the limits, or a text that is not registered."""
        if value and not where and self.door.check is not None:
            try:
                self.door.check(value)
            except InvalidInput as problem:
                own = problem.where.partition(" ")[0] == self.name
                raise problem if own else problem.at(f"{self.name} {problem.where}") from None
        where, door = where or self.name, self.door
        if isinstance(value, Mapping | tuple):
            pairs = value.items() if isinstance(value, Mapping) else [("", one) for one in value]
            for name, one in pairs:
                self.check(one, f"{where} {name}".rstrip())
        elif isinstance(value, str) and door.among is not None:
            check_name(where, value, self.choices)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            factor = FACTORS.get(door.unit, 1.0)
            most = MAX_INTEGER if self.kind is int else MAX_SIZE if door.unit else MAX_NUMBER
            for words, limit, fits in (
                ("more than", door.above, operator.gt),
                ("less than", door.below, operator.lt),
                ("at least", SMALLEST if door.above == 0.0 else door.least, operator.ge),
                ("at least", -most, operator.ge),
                ("at most", most if door.most is None else door.most, operator.le),
            ):
                if limit is not None and not fits(value, limit):
                    found = value if factor == 1.0 else f"{value / factor:.6g} {door.unit}"
                    shown = limit if isinstance(limit, int) else f"{limit / factor:.9g}"
                    raise InvalidInput(where, found=found, expected=f"{words} {shown}")

    def before(self, value: Any) -> Any:
        """Return a value for pydantic; raise for a text or bool that it would take as a number."""
        from pydantic_core import PydanticCustomError

        if self.kind in (int, float) and isinstance(value, str | bytes | bool):
            raise PydanticCustomError("number", "an integer" if self.kind is int else "a number")
        if not is_group(self.kind) or value is None or isinstance(value, Mapping):
            return value
        names = inspect.get_annotations(self.kind)
        if not all(hasattr(value, name) for name in names):
            raise PydanticCustomError("group", f"an object with {' and '.join(names)}")
        return {name: getattr(value, name) for name in names}

    def parsed(self, texts: Sequence[str]) -> Any:
        """Return the value that texts state, with numbers as texts; raise for another form."""
        if self.many:
            if self.door.commas:
                texts = [part.strip() for text in texts for part in text.split(",") if part.strip()]
            pairs = [_parsed(self, self.name, _item(self.kind), text) for text in texts]
            return dict(pairs) if get_origin(self.kind) in (dict, Mapping) else tuple(pairs)
        if len(texts) > 1:
            raise InvalidInput(self.name, found=" and ".join(texts), expected="one value")
        return _parsed(self, self.name, self.kind, texts[0])

    def texts(self, value: Any) -> list[str]:
        """Return the texts that state a value; inverse of `parsed`."""
        if value is None or value == "":
            return []
        if self.many:
            items = value.items() if isinstance(value, Mapping) else value
            every = [_text(self, _item(self.kind), item) for item in items]
            return [",".join(every)] if every and self.door.commas else every
        return [_text(self, self.kind, value)]


def options_of(function: Callable[..., Any], *, leave_out: Sequence[str] = ()) -> list[Option]:
    """Read the options of a function or a dataclass: its parameters, some of which are groups.

    It has annotations and a docstring in NumPy layout.
    """
    said, found = meanings(function.__doc__), []
    scope = vars(sys.modules[function.__module__])
    for name, own in inspect.signature(function).parameters.items():
        if name in leave_out or own.kind is own.VAR_KEYWORD:
            continue
        hint = eval(own.annotation, scope) if isinstance(own.annotation, str) else own.annotation
        required = own.default is inspect.Parameter.empty
        plain = door_of(hint).plain or hint
        if plain is not hint:
            plain = Annotated[(plain, *hint.__metadata__)]
        default = None if required else own.default
        meaning = said.get(name) or door_of(hint).meaning
        place = own.kind is own.POSITIONAL_OR_KEYWORD
        option = Option(name=name, plain=plain, default=default, meaning=meaning, place=place)
        found.append(replace(option, required=required))
    return found


def members(option: Option) -> list[Option]:
    """Return the options that doors show: the fields of a group, or the option itself."""
    if not is_group(option.kind):
        return [option]
    said = meanings(option.kind.__doc__)
    hints = inspect.get_annotations(option.kind, eval_str=True)
    return [
        Option(name=f"{option.name}.{name}", plain=hint, default=None, meaning=said[name])
        for name, hint in hints.items()
    ]


def is_group(kind: Any) -> bool:
    """Whether a type is a dataclass, whose fields are options of their own."""
    return is_dataclass(kind)


def door_of(hint: Any) -> Door:
    """Return the `Door` of an annotation."""
    own = (one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Door))
    return next(own, Door())


def _bare(hint: Any) -> Any:
    while True:
        if get_origin(hint) is Annotated:
            hint = hint.__origin__
        elif get_origin(hint) in (Union, UnionType):
            several = [one for one in get_args(hint) if one is not NoneType]
            if len(several) > 1:  # a text or a number
                return hint
            hint = several[0]
        else:
            return hint


def _item(kind: Any) -> Any:
    """Type of one of the values of an option that may be repeated."""
    inner = get_args(kind)
    return kind if get_origin(kind) in (dict, Mapping) else inner[0]


def _metavar(kind: Any) -> str:
    inner = get_args(kind)
    if get_origin(kind) in (dict, Mapping):
        return f"NAME={_metavar(_bare(inner[1])).replace('FLOAT', 'VALUE')}"
    if get_origin(kind) is tuple:
        return _metavar(inner[0]) if inner[1:] == (...,) else "LOW:HIGH"
    return "|".join(inner) if get_origin(kind) is Literal else _METAVARS.get(kind, "TEXT")


def _parsed(option: Option, where: str, kind: Any, text: str) -> Any:
    """Split one text by the form of its type; the check of the request converts its numbers."""
    inner = get_args(kind)
    if get_origin(kind) in (dict, Mapping):
        name, equals, rest = (part.strip() for part in text.partition("="))
        if not (name and equals):
            raise InvalidInput(f"{where} {text}", found=repr(text), expected=option.metavar)
        optional = NoneType in get_args(inner[1])
        if optional and rest.lower() == NONE:
            return name, None
        return name, _parsed(option, f"{where} {name}", _bare(inner[1]), rest)
    if get_origin(kind) is tuple:
        ends = text.split(":")
        if len(ends) != len(inner):
            expected = "two numbers with a colon, such as 2:4"
            raise InvalidInput(where, found=repr(text), expected=expected)
        return tuple(number_of(end, where) for end in ends)
    if kind is float:
        return FACTORS.get(option.door.unit, 1.0) * number_of(text, where)
    if get_origin(kind) in (Union, UnionType):
        with suppress(InvalidInput):
            return number_of(text, where)
    if kind is int and re.fullmatch(r"[-+]?[0-9]+", text.strip()):
        return int(text)
    if kind is bool:
        check_name(where, text, _YES)
        return text == _YES[0]
    return text


def _text(option: Option, kind: Any, value: Any) -> str:
    if get_origin(kind) in (dict, Mapping):
        name, own = value
        return f"{name}={NONE if own is None else _text(option, _bare(get_args(kind)[1]), own)}"
    if get_origin(kind) is tuple:
        return ":".join(map(repr, value))
    if kind is bool:
        return _YES[0] if value else _YES[1]
    if option.door.unit:
        return repr(in_unit(value, option.door.unit))
    return repr(float(value)) if kind is float or isinstance(value, float) else str(value)


def in_unit(value: float, unit: str) -> float:
    """Return the shortest number that states an SI value in a unit of `FACTORS`, or the nearest."""
    factor = FACTORS[unit]
    near = value / factor
    tried = [near, *_neighbours(near, math.inf), *_neighbours(near, -math.inf)]
    exact = [number for number in tried if factor * number == value]
    return min(exact, key=lambda number: len(repr(number)), default=near)


def _neighbours(number: float, towards: float) -> Iterator[float]:
    for _ in range(3):
        number = math.nextafter(number, towards)
        yield number


# --- options that several capabilities share ----------------------------------------------------

Seed = Annotated[int, Door(least=0, most=2**32 - 1, meaning="Seed of the random numbers.")]
Level = Annotated[float, Door(above=0.0, below=1.0)]
Threads = Annotated[int | None, Door(least=1, effort=True)]
Save = Annotated[bool, Door(effort=True)]
ConditionName = Annotated[str | None, Door(metavar="CONDITION", condition=True)]
MotionName = Annotated[  # of states without velocities
    "AbstractMotionModel | str | None", Door(plain=Literal["quasistatic", "first-order"] | None)
]


def check_fit(settings: Sequence[str]) -> None:
    """Raise `InvalidInput` for a parameter or bounds that no scene can have."""
    from fixel.calibration.usual_parameters import check_fit

    check_fit(settings)


def check_values(values: Mapping[str, float]) -> None:
    """Raise `InvalidInput` for a value that its parameter cannot have."""
    from fixel.model.parameters import KNOWN_PARAMETERS, Parameters

    Parameters({name: own for name, own in values.items() if name in KNOWN_PARAMETERS})


# Values of parameters, parameters to calibrate, and a stored calibration.
Values = Annotated[
    Mapping[str, float] | None, Door(flag="--set", metavar="NAME=NUMBER", check=check_values)
]
Fit = Annotated[tuple[str, ...], Door(metavar="NAME[=LOW:HIGH[:START]]", check=check_fit)]
CalibrationId = Annotated[int | None, Door(metavar="ID", least=1)]

# Options that select experiments.
Dataset = Annotated[str, Door(metavar="NAME", meaning="Select only experiments of this dataset.")]
Where = Annotated[
    tuple[str, ...],
    Door(
        metavar="FILTER",
        meaning='Select experiments that match, such as "surface=abs error>5 real"; '
        "may be repeated.",
    ),
]
Flagged = Annotated[bool, Door(flag="--all", meaning="Include experiments whose data have faults.")]
Names = Annotated[Sequence[str], Door(plain=tuple[str, ...], metavar="NAME[,NAME]", commas=True)]
# Engine of a stored calibration, or of its simulations; empty for none.
EngineName = Annotated[str, Door(metavar="NAME", program=True)]
# A model of fixel, another engine, or the path of a program, under either flag.
Motion = Annotated[
    "AbstractMotionModel | str | None",
    Door(plain=str | None, metavar="NAME", also=("--engine",), program=True),
]


@dataclass(frozen=True, slots=True)
class StatedNoise:
    """Noise of measured poses, as a request states it.

    Attributes
    ----------
    position_m : float
        Standard deviation of measured positions.
    angle_rad : float
        Standard deviation of measured angles.
    """

    position_m: Annotated[float, Door(unit="mm", above=0.0)]
    angle_rad: Annotated[float, Door(unit="mrad", above=0.0)]

    def build(self) -> Noise:
        """Return the noise for Python."""
        from fixel.calibration.noise import Noise

        return Noise(position_m=self.position_m, angle_rad=self.angle_rad)


NoiseOption = Annotated["Noise | None", Door(plain=StatedNoise | None, usual="estimated")]

# Option of a capability whose experiments may stand on a mapped table.
TABLE: Final = Option(
    name="table",
    plain=Path | None,
    default=None,
    meaning="Map of an uneven table, saved by fixel table map, for the experiments on it.",
)
