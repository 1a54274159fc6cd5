"""Model of a task in SDF, with tags of Drake."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from fixel.simulation.engines.solids import FOOT, HEAVY, footed, prism_obj, solids
from fixel.simulation.engines.task import PlainOutline, PlainTask
from fixel.typing import FloatArray

CORNER = 1e-5  # [m] radius of the balls at corners, where two faces touch at points
HEIGHT = 0.1  # [m] of bodies
MAX_FRICTION = 2.0  # no partner of Drake has a larger harmonic mean with 1
TOUCH = 1e-12  # [m] overlap of feet and floor at the start: without it feet fall for one step

_MODEL: Final = """<?xml version="1.0"?>
<sdf version="1.9" xmlns:drake="drake.mit.edu">
<model name="task">
{}
</model>
</sdf>
"""
# No half space: on a link it has an infinite bounding box, on which Drake crashes now and then.
_FLOOR: Final = f"<box><size>200 200 {HEIGHT}</size></box>"
# Links that do not touch each other, by group: two prisms touch only at the balls in their corners.
_APART: Final[Mapping[str, Sequence[str]]] = {
    "floor": ("object", "obstacles"),
    "feet": ("feet", "object", "obstacles"),
    "object": ("object",),
    "obstacles": ("obstacles",),
    "prisms": ("prisms",),
    "corners": ("corners",),
}


def sdf(task: PlainTask, choices: Mapping[str, Any]) -> Mapping[str, str]:
    """Return the model of a task: ``model.sdf`` and the meshes that it needs, by file name.

    `choices` are the fields of `Drake` by name. The body moves in the plane z = 0, above the floor
    by the radius of its feet, which slide vertically and have its weight. Drake combines two
    coefficients by their harmonic mean: those of floor and body are 1, those of others their
    `harmonic_partner`.
    """
    model, own, pusher = _SdfModel(choices), task.body, task.pusher
    ground = model.collision("floor", _FLOOR, 1.0, _pose(0.0, 0.0, z=TOUCH - FOOT - HEIGHT / 2))
    model.link("floor", ["floor"], [ground])
    model.parts.append(_weld("world", "floor"))
    feet = footed(own, task.gravity)
    model.body("object", "object", own.outline, 1.0, _inertial(feet.mass, feet.inertia))
    model.parts.append(_planar("object"))
    masses, friction = feet.masses.tolist(), feet.friction.tolist()
    for k, place in enumerate(feet.points.tolist()):
        name = f"foot{k}"
        ball = model.collision(name, _ball(FOOT), harmonic_partner(friction[k]))
        inertial = _inertial(masses[k], feet.foot_inertia, _pose(-place[0], -place[1]))
        model.link(name, ["feet"], [ball], inertial, (*place, 0.0))
        model.parts.append(_slide(name))
    outline = PlainOutline((), 0.0) if pusher is None else pusher.outline
    partner = 1.0 if pusher is None else harmonic_partner(pusher.friction)
    model.body("pusher", "obstacles", outline, partner, _inertial(HEAVY, HEAVY))
    model.parts.append(_planar("pusher"))
    for k, fixel in enumerate(task.fixels):
        name, partner = f"fixel{k}", harmonic_partner(fixel.friction)
        model.body(name, "obstacles", fixel.outline, partner, at=fixel.pose.tolist())
        model.parts.append(_weld("world", name))
    return model.files()


class _SdfModel:
    """Parts of a model in the order of its file, its meshes, and its links by group."""

    def __init__(self, choices: Mapping[str, Any]) -> None:
        self.parts: list[str] = []
        self.meshes: dict[str, str] = {}
        self.groups: dict[str, list[str]] = {group: [] for group in _APART}
        self._contact = (
            f"<drake:point_contact_stiffness>{choices['stiffness']!r}"
            "</drake:point_contact_stiffness>"
            f"<drake:hunt_crossley_dissipation>{choices['dissipation']!r}"
            "</drake:hunt_crossley_dissipation>"
            f"<drake:relaxation_time>{choices['relaxation']!r}</drake:relaxation_time>"
        )

    def body(
        self,
        name: str,
        group: str,
        outline: PlainOutline,
        friction: float,
        inertial: str = "",
        at: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Add a link with the pieces of an outline, and one with the balls inside their corners.

        A disc is a ball, which touches prisms, corners and other discs.
        """
        pieces, corners = [], []
        for k, solid in enumerate(solids(outline)):
            own = f"{name}{k}"
            if solid.kind == "disc":
                shape = _ball(outline.radius)
            elif solid.kind == "box":
                length, width = solid.size
                shape = f"<box><size>{length!r} {width!r} {HEIGHT}</size></box>"
            else:
                self.meshes[f"{own}.obj"] = prism_obj(solid.corners, HEIGHT)
                shape = f"<mesh><uri>{own}.obj</uri><drake:declare_convex/></mesh>"
            pieces.append(self.collision(own, shape, friction, _pose(*solid.at)))
            tips = [] if solid.kind == "disc" else _inner(solid.corners).tolist()
            corners += [
                self.collision(f"{own}_{j}", _ball(CORNER), friction, _pose(x, y))
                for j, (x, y) in enumerate(tips)
            ]
        self.link(name, [group, "prisms"] if corners else [group], pieces, inertial, at)
        if corners:
            held = f"{name}_corners"
            self.link(held, [group, "corners"], corners, _inertial(0.0, 0.0), at)
            self.parts.append(_weld(name, held))

    def link(
        self,
        name: str,
        groups: Iterable[str],
        collisions: Iterable[str],
        inertial: str = "",
        at: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Add a link at a pose x, y, theta."""
        for group in groups:
            self.groups[group].append(name)
        inside = "\n".join(filter(None, (_pose(*at), inertial, *collisions)))
        self.parts.append(f'<link name="{name}">\n{inside}\n</link>')

    def collision(self, name: str, shape: str, friction: float, pose: str = "") -> str:
        """Return the text of a shape of a link."""
        return (
            f'<collision name="{name}">{pose}<geometry>{shape}</geometry>'
            f"<drake:proximity_properties><drake:mu_static>{friction!r}</drake:mu_static>"
            f"<drake:mu_dynamic>{friction!r}</drake:mu_dynamic>{self._contact}"
            "</drake:proximity_properties></collision>"
        )

    def files(self) -> Mapping[str, str]:
        """Return the texts of the files by name."""
        filters = []
        for group, names in self.groups.items():
            inside = [f"<drake:member>{name}</drake:member>" for name in names]
            inside += [
                f"<drake:ignored_collision_filter_group>{other}_group"
                "</drake:ignored_collision_filter_group>"
                for other in _APART[group]
                if self.groups[other]
            ]
            if names:
                filters.append(
                    f'<drake:collision_filter_group name="{group}_group">\n'
                    + "\n".join(inside)
                    + "\n</drake:collision_filter_group>"
                )
        return {"model.sdf": _MODEL.format("\n".join(self.parts + filters)), **self.meshes}


def _pose(x: float, y: float, theta: float = 0.0, *, z: float = 0.0) -> str:
    return f"<pose>{x!r} {y!r} {z!r} 0 0 {theta!r}</pose>"


def _ball(radius: float) -> str:
    return f"<sphere><radius>{radius!r}</radius></sphere>"


def _inertial(mass: float, inertia: float, at: str = "") -> str:
    axes = "".join(f"<{axis}>{inertia!r}</{axis}>" for axis in ("ixx", "iyy", "izz"))
    return f"<inertial>{at}<mass>{mass!r}</mass><inertia>{axes}</inertia></inertial>"


def _weld(parent: str, child: str) -> str:
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{child}_weld" type="fixed">{ends}</joint>'


def _planar(link: str) -> str:
    return (
        f'<drake:joint name="{link}_plane" type="planar"><drake:parent>floor</drake:parent>'
        f"<drake:child>{link}</drake:child><drake:damping>0 0 0</drake:damping></drake:joint>"
    )


def _slide(foot: str) -> str:
    """Return the joint of a foot; without an effort it has no actuator."""
    return (
        f'<joint name="{foot}_slide" type="prismatic"><parent>object</parent><child>{foot}</child>'
        "<axis><xyz>0 0 1</xyz><limit><effort>0</effort></limit></axis></joint>"
    )


def _inner(corners: FloatArray) -> FloatArray:
    """Return the centres of balls that touch both edges at each corner of a convex polygon."""
    ahead = np.roll(corners, -1, axis=0) - corners
    ahead /= np.hypot(*ahead.T)[:, None]
    back = -np.roll(ahead, 1, axis=0)
    bisector = ahead + back
    bisector /= np.hypot(*bisector.T)[:, None]
    sine = np.abs(bisector[:, 0] * ahead[:, 1] - bisector[:, 1] * ahead[:, 0])
    return corners + CORNER * bisector / sine[:, None]


def harmonic_partner(friction: float) -> float:
    """Return the coefficient that combines with 1 to `friction`: Drake takes the harmonic mean."""
    return friction / (2.0 - friction)
