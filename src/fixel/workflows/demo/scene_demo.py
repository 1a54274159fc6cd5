"""Short tour: one grasp is simulated, drawn and filmed, and its events are described."""

from __future__ import annotations

from importlib.resources import as_file, files
from math import degrees
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel.drawing.animation import film_ending
from fixel.formats import load_scene
from fixel.io.atomic import write_whole
from fixel.model import LineDrive, placed
from fixel.simulation import Simulation
from fixel.typing import FloatArray
from fixel.workflows.analysis import new_folder
from fixel.workflows.simulation import Outputs, simulate_file

EXAMPLE = "grasp"
# Slip slower than this share of the body's fastest motion counts as sticking.
STICKING = 1e-3


class Demo(NamedTuple):
    """Result of the tour."""

    simulation: Simulation
    events: list[MotionEvent]  # events of the motion, in order
    files: dict[str, Path]  # ``scene``, ``plot``, ``animate``, ``trajectory``


def example_names() -> list[str]:
    """Return the names of the scenes that come with fixel."""
    folder = files("fixel.testing") / "examples"
    return sorted(Path(f.name).stem for f in folder.iterdir() if f.name.endswith(".yaml"))


def example_text(name: str) -> str:
    """Return the scene file of an example, with its comments."""
    with as_file(files("fixel.testing") / "examples" / f"{name}.yaml") as path:
        return path.read_text(encoding="utf-8")


def run_demo(folder: Path) -> Demo:
    """Simulate the example grasp; write its scene, picture, film and trajectory into a folder.

    Files of the same names are replaced.
    """
    scene = folder / f"{EXAMPLE}.yaml"
    endings = {"trajectory": ".csv", "plot": ".png", "animate": film_ending()}
    files = {name: scene.with_suffix(ending) for name, ending in endings.items()}
    with new_folder(folder):
        write_whole(scene, example_text(EXAMPLE))
        simulation = simulate_file(load_scene(scene), Outputs(**files))
    return Demo(simulation, motion_events(simulation), {"scene": scene, **files})


class MotionEvent(NamedTuple):
    """Event of a motion, as text."""

    time: float  # [s]
    text: str


def motion_events(simulation: Simulation) -> list[MotionEvent]:
    """Return the events of the first body of a scene, in order.

    A sample at every step of the simulation gives events the time of their step.
    """
    body = simulation.scene.bodies[0].name
    events = [
        *_meets_pushers(simulation, body),
        *_meets_fixels(simulation, body),
        *_stalls(simulation, body),
    ]
    if simulation.stopped_at is not None:
        events.append(MotionEvent(simulation.stopped_at, f"stopped: {simulation.status}"))
    return sorted(events, key=lambda event: event.time)


def _rows(simulation: Simulation, body: str, other: str) -> NDArray[np.void]:
    names, table = simulation.names, simulation.contacts
    a, b = names.index(body), names.index(other)
    return np.asarray(table[(table["body"] == a) & (table["other"] == b)])


def _sample(simulation: Simulation, time: float) -> int:
    return int(np.searchsorted(simulation.time, time))


def _angle(simulation: Simulation, body: str, time: float) -> str:
    angle = degrees(simulation.pose[body][_sample(simulation, time), 2])
    return f"{angle:.1f} deg".replace("-0.0 ", "0.0 ")


def _meets_pushers(simulation: Simulation, body: str) -> list[MotionEvent]:
    events = []
    for pusher in simulation.scene.pushers:
        rows = _rows(simulation, body, pusher.name)
        if not len(rows):
            continue
        first = float(rows["time"][0])  # the step in which a gap closes ends with it
        angle = _angle(simulation, body, first)
        events.append(MotionEvent(first, f"{pusher.name} touches {body}, which stands at {angle}"))
        times, points = np.unique(rows["time"], return_counts=True)
        if points[0] == 1 and (points > 1).any():
            flat = float(times[np.argmax(points > 1)])
            angle = _angle(simulation, body, flat)
            events.append(
                MotionEvent(flat, f"face to face: {body} lies flat against it, at {angle}")
            )
    return events


def _meets_fixels(simulation: Simulation, body: str) -> list[MotionEvent]:
    events = []
    for fixel in simulation.scene.fixels:
        rows = _rows(simulation, body, fixel.name)
        if not len(rows):
            continue
        first = float(rows["time"][0])
        events.append(
            MotionEvent(first, f"{body} meets {fixel.name}, at {_angle(simulation, body, first)}")
        )
        way, until = _slip(simulation, body, rows)
        how = (
            f"{body} sticks to {fixel.name} after sliding along it by {1e3 * way:.2f} mm"
            if until > first
            else f"{body} sticks to {fixel.name} from the first touch on"
        )
        if rows["time"][-1] == simulation.time[-1]:
            events.append(MotionEvent(until, how))
        else:
            events.append(MotionEvent(float(rows["time"][-1]), f"{body} leaves {fixel.name}"))
    return events


def _slip(simulation: Simulation, body: str, rows: NDArray[np.void]) -> tuple[float, float]:
    """Return the distance [m] that a contact slid, and the time of the last such sample [s]."""
    speeds = np.array([_slip_speed(simulation, body, row) for row in rows])
    fastest = float(np.abs(np.concatenate([t[:, :2] for t in simulation.twist.values()])).max())
    slides = speeds > STICKING * fastest
    slides[0] = False  # in that step the body was still on its way
    way = float((speeds * rows["step"])[slides].sum())
    until = rows["time"][slides][-1] if slides.any() else rows["time"][0]
    return way, float(until)


def _slip_speed(simulation: Simulation, body: str, row: np.void) -> float:
    """Speed of the body's material along a fixed surface [m/s]."""
    sample = _sample(simulation, float(row["time"]))
    member = next(b for b in simulation.scene.bodies if b.name == body)
    centre = placed(member.com, simulation.pose[body][sample])
    vx, vy, omega = simulation.twist[body][sample]
    arm = row["point"] - centre
    normal = row["normal"]
    velocity: FloatArray = np.array([vx - omega * arm[1], vy + omega * arm[0]])
    return abs(float(velocity @ np.array([-normal[1], normal[0]])))


def _stalls(simulation: Simulation, body: str) -> list[MotionEvent]:
    events = []
    end = float(simulation.time[-1])
    for pusher in simulation.scene.pushers:
        trace = simulation.pushers[pusher.name]
        if not trace.stalled[-1]:
            if isinstance(pusher.drive, LineDrive) and trace.travel >= pusher.drive.travel:
                way = f"{1e3 * trace.travel:.1f} mm"
                events.append(MotionEvent(end, f"{pusher.name} has reached its travel of {way}"))
            continue
        moving = np.nonzero(~trace.stalled)[0]
        since = int(moving[-1]) + 1 if len(moving) else 0
        force = f"{trace.force[since]:.4g} N"
        seats = [b for a, b in simulation.touching if a == body and b != pusher.name]
        where = f"{body} is seated on " + " and ".join(seats) if seats else f"{body} is held"
        events.append(
            MotionEvent(float(simulation.time[since]), f"{where}; the drive stalls at {force}")
        )
        moved = simulation.pose[body][-1] - simulation.pose[body][since]
        held = end - simulation.time[since]
        drift = f"{1e9 * np.hypot(moved[0], moved[1]):.2g} nm, {abs(moved[2]):.1g} rad"
        events.append(MotionEvent(end, f"held for {held:.2f} s; drift since the stall: {drift}"))
    return events
