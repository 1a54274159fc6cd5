"""Planar rigid bodies in frictional contact, solved as complementarity problems.

The public names are imported when first used, so that `import fixel` and `fixel --help` stay light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fixel.errors import InvalidInput, SolveFailed
    from fixel.formats import load_scene
    from fixel.model import (
        Body,
        Disk,
        Ellipsoid,
        Fixel,
        LineDrive,
        NoSupport,
        PairFriction,
        Parameters,
        PathDrive,
        Plane,
        Polygon,
        Pusher,
        Scene,
        SupportPoints,
        Tripod,
        UniformPressure,
    )
    from fixel.simulation import (
        Adaptive,
        Dynamic,
        FirstOrder,
        GaussSeidel,
        Lemke,
        Newton,
        QuasiStatic,
        Simulation,
        StewartTrinkle,
        simulate,
        simulate_batch,
    )

    __version__: str

__all__ = [
    "Adaptive",
    "Body",
    "Disk",
    "Dynamic",
    "Ellipsoid",
    "FirstOrder",
    "Fixel",
    "GaussSeidel",
    "InvalidInput",
    "Lemke",
    "LineDrive",
    "Newton",
    "NoSupport",
    "PairFriction",
    "Parameters",
    "PathDrive",
    "Plane",
    "Polygon",
    "Pusher",
    "QuasiStatic",
    "Scene",
    "Simulation",
    "SolveFailed",
    "StewartTrinkle",
    "SupportPoints",
    "Tripod",
    "UniformPressure",
    "__version__",
    "load_scene",
    "simulate",
    "simulate_batch",
]

_HOME_OF = {
    **dict.fromkeys(("InvalidInput", "SolveFailed"), "fixel.errors"),
    **dict.fromkeys(("load_scene",), "fixel.formats"),
    **dict.fromkeys(
        (
            "Body",
            "Disk",
            "Ellipsoid",
            "Fixel",
            "LineDrive",
            "NoSupport",
            "PairFriction",
            "Parameters",
            "PathDrive",
            "Plane",
            "Polygon",
            "Pusher",
            "Scene",
            "SupportPoints",
            "Tripod",
            "UniformPressure",
        ),
        "fixel.model",
    ),
    **dict.fromkeys(
        (
            "Adaptive",
            "Dynamic",
            "FirstOrder",
            "GaussSeidel",
            "Lemke",
            "Newton",
            "QuasiStatic",
            "Simulation",
            "StewartTrinkle",
            "simulate",
            "simulate_batch",
        ),
        "fixel.simulation",
    ),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("fixel")
    elif name in _HOME_OF:
        value = getattr(import_module(_HOME_OF[name]), name)
    else:
        raise AttributeError(f"module 'fixel' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
