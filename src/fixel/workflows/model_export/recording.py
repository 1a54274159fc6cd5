"""Motions as MCAP files, for Foxglove and its kin, and as recordings for the viewer rerun."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from fixel.errors import InvalidInput, require
from fixel.model.shape import Disk, Shape, placed
from fixel.simulation import Simulation
from fixel.simulation.simulate import simulate
from fixel.typing import FloatArray
from fixel.workflows.model_export.source import ModelSource

INTERVAL: Final = 0.02  # [s] between poses
HEIGHT: Final = 0.01  # [m] of measured parts over the plane, so that both are seen
# Red, green and blue, from 0 to 1.
_COLOURS: Final = {
    "part": (0.25, 0.5, 0.85),
    "pusher": (0.9, 0.5, 0.15),
    "fixel": (0.45, 0.45, 0.45),
    "measured": (0.3, 0.7, 0.35),
}


class BodyMotion(NamedTuple):
    """Body with its poses, one for each time."""

    name: str
    kind: str
    corners: FloatArray  # (3 m, 3) of triangles that fill its shape, in its frame [m]
    time: FloatArray  # (n,) [s]
    pose: FloatArray  # (n, 3) [m, m, rad]


def motion_of(source: ModelSource) -> tuple[list[BodyMotion], list[str]]:
    """Return the motion of the first case, simulated unless it is known, and what it lacks."""
    case = source.cases[0]
    runs = source.runs or (
        simulate(
            case.scene,
            {name: value for name, value in case.values.items() if "." not in name},
            motion=source.motion,
            stepper=source.stepper,
            output_interval=INTERVAL,
        ),
    )
    found = [*_joined(runs, case.values)]
    if case.measured is not None:
        name = f"{found[0].name} measured"
        corners = found[0].corners + np.array([0.0, 0.0, HEIGHT])
        found.append(BodyMotion(name, "measured", corners, case.times, case.measured))
    for name, n in Counter(["world", *(one.name for one in found)]).items():
        if n > 1:
            expected = f"another name: the recording has its own frame {name!r}"
            raise InvalidInput("name of a body", found=repr(name), expected=expected)
    stopped = (run for run in runs if run.stopped_at is not None)
    lost = [f"motion after {run.time[-1]:g} s: {run.status}" for run in stopped]
    return found, ["masses, friction and forces", *lost]


def _joined(runs: tuple[Simulation, ...], values: Mapping[str, float]) -> Iterator[BodyMotion]:
    """Yield the things of simulations with these parameters, one after the other in time."""
    outline = [values.get(f"outline_{axis}", 0.0) for axis in ("x", "y", "theta")]
    starts = np.cumsum([0.0, *(run.time[-1] for run in runs)])
    time = np.concatenate([run.time + start for run, start in zip(runs, starts, strict=False)])
    scene = runs[0].scene
    for kind, things, at in (("part", scene.bodies, outline), ("pusher", scene.pushers, (0, 0, 0))):
        grown = values.get("contact_offset", 0.0) if kind == "pusher" else 0.0
        for thing in things:
            pose = np.vstack([run.pose[thing.name] for run in runs])
            yield BodyMotion(thing.name, kind, _triangles(thing.shape, at, grown), time, pose)
    for fixel in scene.fixels:
        pose = np.array([fixel.pose])
        yield BodyMotion(fixel.name, "fixel", _triangles(fixel.shape), time[:1], pose)


def _triangles(shape: Shape, at: Sequence[float] = (0, 0, 0), grown: float = 0.0) -> FloatArray:
    """Return corners (3 m, 3) of triangles that fill a shape at a pose; `grown` is for disks."""
    scale = 1.0 + grown / shape.radius if isinstance(shape, Disk) else 1.0
    fans = [own[[0, k, k + 1]] for own, _ in shape.pieces for k in range(1, len(own) - 1)]
    return np.insert(placed(scale * np.vstack(fans), at), 2, 0.0, axis=1)


def write_mcap(path: Path, found: list[BodyMotion]) -> None:
    """Write motions as Foxglove's FrameTransforms on /tf and SceneUpdate on /scene, in JSON."""
    require("mcap", "a recording in MCAP", extra="files")
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="fixel")

        def channel(topic: str, schema: str) -> Callable[[float, Mapping[str, Any]], None]:
            number = writer.register_schema(schema, "jsonschema", b'{"type": "object"}')
            own = writer.register_channel(topic, "json", number)

            def add(time: float, content: Mapping[str, Any]) -> None:
                at = round(1e9 * time)
                data = json.dumps(content, allow_nan=False).encode()
                writer.add_message(own, log_time=at, data=data, publish_time=at)

            return add

        scene = channel("/scene", "foxglove.SceneUpdate")
        transforms = channel("/tf", "foxglove.FrameTransforms")
        scene(0.0, {"deletions": [], "entities": [_entity(body) for body in found]})
        rows = [(t, body, row) for body in found for row, t in enumerate(body.time.tolist())]
        for time, body, row in sorted(rows, key=lambda one: one[0]):
            transforms(time, {"transforms": [_transform(body, row)]})
        writer.finish()


def _stamp(time: float) -> dict[str, int]:
    sec, nsec = divmod(round(1e9 * time), 10**9)
    return {"sec": sec, "nsec": nsec}


def _transform(body: BodyMotion, row: int) -> dict[str, Any]:
    x, y, angle = body.pose[row].tolist()
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(angle / 2)), "w": float(np.cos(angle / 2))}
    return {
        "timestamp": _stamp(float(body.time[row])),
        "parent_frame_id": "world",
        "child_frame_id": body.name,
        "translation": {"x": x, "y": y, "z": 0.0},
        "rotation": turn,
    }


def _entity(body: BodyMotion) -> dict[str, Any]:
    none = dict.fromkeys("xyz", 0.0)
    triangles = {
        "pose": {"position": none, "orientation": none | {"w": 1.0}},
        "points": [dict(zip("xyz", corner, strict=True)) for corner in body.corners.tolist()],
        "color": dict(zip("rgba", (*_COLOURS[body.kind], 1.0), strict=True)),
        "colors": [],
        "indices": [],
    }
    return {
        "timestamp": _stamp(0.0),
        "frame_id": body.name,
        "id": body.name,
        "lifetime": _stamp(0.0),
        "frame_locked": True,
        "metadata": [],
        "triangles": [triangles],
    }


def write_rerun(path: Path, found: list[BodyMotion]) -> None:
    """Write motions as a recording for rerun."""
    require("rerun", "a recording for rerun", extra="rerun")
    import rerun

    recording = rerun.RecordingStream("fixel")
    recording.save(path)
    for body in found:
        name, (x, y, angle) = rerun.new_entity_path(["world", body.name]), body.pose.T
        recording.log(
            name,
            rerun.Mesh3D(vertex_positions=body.corners, albedo_factor=_COLOURS[body.kind]),
            static=True,
        )
        turn = np.column_stack((0.0 * x, 0.0 * x, np.sin(angle / 2), np.cos(angle / 2)))
        recording.send_columns(
            name,
            indexes=[rerun.TimeColumn("time", duration=body.time)],
            columns=rerun.Transform3D.columns(
                translation=np.column_stack((x, y, 0.0 * x)), quaternion=turn
            ),
        )
    recording.flush()
    recording.disconnect()


WRITERS: Final[Mapping[str, tuple[str, Callable[[Path, list[BodyMotion]], None]]]] = {
    "mcap": ("motion.mcap", write_mcap),
    "rerun": ("motion.rrd", write_rerun),
}
