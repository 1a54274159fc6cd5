"""Convert tracks to an experiment with the scene as the camera measured it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fixel import model
from fixel.datasets.base import remark, scene_or_flag
from fixel.errors import InvalidInput
from fixel.typing import FloatArray
from fixel.uncertainty.start_ensemble import Neighbour, remove_overlap
from fixel.vision.marks import Rig
from fixel.vision.tracking.base import ActuatorMotion, FilmTracks, PartTrack, Thing, motion_of
from fixel.vision.tracking.judge import clock_scatter

MAX_APART: Final = 1.5e-3  # [m] largest displacement of a start out of an overlap
MAX_GAPS: Final = 0.5  # fraction of the frames, beyond which an object counts as lost
REST_DISTANCE: Final = 0.1e-3  # [m] largest apparent motion of a resting object
STARTS: Final = 5  # frames that decide whether an object rests
LAST: Final = 0.5  # [s] of readings that decide the contact mode
CAMERA: Final = "camera"  # condition of a film whose camera is not where the rig places it
RESTLESS: Final = 0.2e-3  # [m] largest scatter of a fixel's places; 0.03 mm are usual
MISPLACED: Final = 0.02  # [m] largest distance of a start from its planned place


class Readings(NamedTuple):
    """Tactile bytes of each frame."""

    time: FloatArray  # (n,) times of the readings [s]
    value: NDArray[np.int64]  # (n,) tactile bytes; -1 for none


def actuator_motion(tracked: FilmTracks, scene: model.Scene) -> tuple[str, ActuatorMotion] | None:
    """Return the name of the tracked pusher and its motion; None if none was tracked."""
    for pusher in scene.pushers:
        track = tracked.parts.get(pusher.name)
        if track is not None and track.good.sum() > 1:
            time, place = track.time[track.good], track.pose[track.good, :2]
            noise = float(np.median(np.hypot(track.sd[track.good, 0], track.sd[track.good, 1])))
            # The uncertainty of a time stamp displaces a place along its path.
            fastest = np.hypot(*(place[-1] - place[0])) / (time[-1] - time[0])
            late = float(fastest) * float(np.median(clock_scatter(track.time)))
            return pusher.name, motion_of(time, place, max(noise, late, 1e-9))
    return None


def experiment_of(
    tracked: FilmTracks,
    rig: Rig,
    scene: model.Scene,
    readings: Readings | None,
    *,
    dataset: str,
    name: str,
    provenance: model.Provenance,
    simulated_by: str = "",
    remarks: tuple[str, ...] = (),
) -> model.Experiment:
    """Build an experiment whose clock begins with the first frame.

    The planned scene has shapes, masses and nominal friction. Remarks are about the video or
    recording. The program that rendered the film is empty for a camera. If no tracked part has the
    name of the object, raise `InvalidInput`.
    """
    zero = float(tracked.time[0])
    body = scene.bodies[0]
    if body.name not in tracked.parts:
        raise InvalidInput(
            f"rig {rig.name!r}",
            found="the parts " + ", ".join(map(repr, tracked.parts)),
            expected=f"a part named {body.name!r}, like the body of the scene",
        )
    track = tracked.parts[body.name]
    trajectory = _shifted(track.trajectory, zero)
    found = actuator_motion(tracked, scene)
    pusher = None if found is None else _shifted(tracked.parts[found[0]].trajectory, zero)
    motion = None if found is None else found[1]
    effective = (
        (motion.start - zero, motion.end - zero) if motion is not None and motion.moved else None
    )
    begins = effective[0] if effective else float(trajectory.time[-1])
    flags = [*_flags(tracked, track, scene, motion, remarks)]
    moved: list[float] = []
    measured, why_not = scene_or_flag(
        lambda: _scene(scene, trajectory, pusher, found, tracked, begins, moved)
    )
    if moved:
        detail = f"the measured start was moved by {moved[0] * 1e3:.3f} mm to remove an overlap"
        flags.append(remark("start-moved", detail))
    tactile = None if readings is None else _tactile(readings, rig, scene, zero)
    return model.Experiment(
        dataset=dataset,
        name=name,
        real=not simulated_by,
        simulated_by=simulated_by,
        provenance=provenance,
        object_name=body.name,
        trajectory=trajectory,
        pusher=pusher,
        scene=measured,
        height=rig.parts[body.name].height,
        pusher_height=None if found is None else rig.parts[found[0]].height,
        fixel_height=rig.fixel_height if scene.fixels else None,
        channels=() if tactile is None else (tactile,),
        contact_mode="" if tactile is None else contact_mode(tactile, effective),
        effective=effective,
        conditions=_conditions(tracked, rig, motion),
        flags=(*flags, *why_not),
    )


def contact_mode(tactile: model.Channel, effective: tuple[float, float] | None) -> str:
    """Majority of the readings at the end of the motion and after it, one digit per fixel."""
    end = tactile.time[-1] if len(tactile.time) else 0.0
    begin = max(end - LAST, effective[0] if effective else 0.0)
    last = tactile.values[tactile.time >= begin]
    last = last[np.isfinite(last).all(1)]
    if not len(last):
        return ""
    return "".join(str(int(share > 0.5)) for share in last.mean(0))


def _scene(
    scene: model.Scene,
    trajectory: model.Trajectory,
    pusher: model.Trajectory | None,
    found: tuple[str, ActuatorMotion] | None,
    tracked: FilmTracks,
    begins: float,
    moved: list[float],
) -> model.Scene:
    """Return the scene with measured instead of planned poses."""
    _check_single_push(found)
    places = {fixel.name: fixel.place for fixel in tracked.fixels}
    fixels = tuple(
        replace(fixel, pose=np.append(places[fixel.name], fixel.pose[2]))
        if fixel.name in places
        else fixel
        for fixel in scene.fixels
    )
    pushers = tuple(
        _driven(member, pusher) if found and pusher and member.name == found[0] else member
        for member in scene.pushers
    )
    bodies: list[model.Body] = []
    for body in scene.bodies:
        pose = body.pose
        if body.name in tracked.parts:
            track = _shifted(tracked.parts[body.name].trajectory, float(tracked.time[0]))
            _check_start(body.name, track, begins)
            start = _start(track, begins)
            pose = _apart(body.shape, start, (*pushers, *fixels, *bodies))
            if (pose != start).any():
                moved.append(float(np.hypot(*(pose - start)[:2])))
        bodies.append(replace(body, pose=pose))
    end = float(trajectory.time[-1])
    return replace(scene, bodies=tuple(bodies), pushers=pushers, fixels=fixels, duration=end)


def _driven(pusher: model.Pusher, measured: model.Trajectory) -> model.Pusher:
    """Return a pusher on its measured path; its head does not turn, so its angle is constant."""
    angle = np.full(len(measured.time), float(np.median(np.unwrap(measured.pose[:, 2]))))
    path = np.column_stack((measured.time, measured.pose[:, :2], angle))
    drive = model.PathDrive(waypoints=path, force_limit=pusher.drive.force_limit)
    return replace(pusher, drive=drive, pose=path[0, 1:])


def _check_single_push(found: tuple[str, ActuatorMotion] | None) -> None:
    if found is None or found[1].back is None:
        return
    begin, end = found[1].back
    raise InvalidInput(
        "film",
        found=f"{found[0]} moves back from {begin:.2f} to {end:.2f} s and pushes again",
        expected="one push",
        hint="cut the film there and track its parts one by one",
    )


def _check_start(name: str, trajectory: model.Trajectory, begins: float) -> None:
    """Reject an object that is first seen after the push has begun and is already moving."""
    first = float(trajectory.time[0])
    early = trajectory.pose[:STARTS, :2] - trajectory.pose[0, :2]
    if first > begins and np.hypot(*early.T).max() > REST_DISTANCE:
        found = f"it first visible at {first:.2f} s, when it already moved"
        expected = "its start in the film, where a simulation begins"
        raise InvalidInput(name, found=found, expected=expected)


def _start(trajectory: model.Trajectory, begins: float) -> FloatArray:
    """(3,) pose before anything moved: the mean, if the object rested."""
    early = trajectory.pose[trajectory.time < begins]
    still = np.hypot(*(early[:, :2] - trajectory.pose[0, :2]).T) < REST_DISTANCE
    n = int(np.argmin(still)) if not still.all() else len(still)
    return trajectory.pose[0] if n < 3 else np.asarray(np.mean(early[:n], axis=0))


def _apart(shape: object, start: FloatArray, others: Iterable[Thing | model.Fixel]) -> FloatArray:
    neighbours = [Neighbour(other.name, other.shape, other.pose) for other in others]
    poses, reasons = remove_overlap(shape, start[None], neighbours, MAX_APART)  # type: ignore[arg-type]
    if reasons[0]:
        raise InvalidInput("scene", found=f"an overlap ({reasons[0]})", expected="none")
    return np.asarray(poses[0])


def _tactile(readings: Readings, rig: Rig, scene: model.Scene, zero: float) -> model.Channel | None:
    names = [fixel.name for fixel in scene.fixels]
    bits = [rig.tactile.index(name) for name in names if name in rig.tactile]
    if len(bits) != len(names) or not names or (readings.value < 0).all():
        return None
    value = readings.value[:, None] >> np.array(bits) & 1
    values = np.where(readings.value[:, None] < 0, np.nan, value.astype(np.float64))
    return model.Channel.of_fixels(np.maximum.accumulate(readings.time) - zero, values)


def _conditions(
    tracked: FilmTracks, rig: Rig, motion: ActuatorMotion | None
) -> dict[str, str | float]:
    conditions: dict[str, str | float] = {"rig": rig.name, "tracked_by": tracked.method}
    if tracked.rig.camera != rig.camera:
        conditions[CAMERA] = "registered again"
    if motion is not None and motion.moved:
        conditions |= {"speed_m_s": motion.cruise, "travel_m": motion.travel}
    for name, track in tracked.parts.items():
        conditions[f"{name}_residual_m"] = float(np.median(track.residual_m[track.seen]))
        conditions[f"{name}_seen_ratio"] = float(track.good.mean())
    return conditions


def _flags(
    tracked: FilmTracks,
    track: PartTrack,
    scene: model.Scene,
    motion: ActuatorMotion | None,
    remarks: tuple[str, ...],
) -> Iterator[model.Flag]:
    if track.good.mean() < MAX_GAPS:
        share = f"{track.good.mean():.0%}"
        yield model.Flag("object-lost", f"{track.name} was tracked in {share} of the frames")
    for part in tracked.parts.values():
        if part.gaps:
            longest = max(part.gaps, key=lambda gap: gap[1] - gap[0])
            n = int((~part.good).sum())
            yield remark(
                f"{_plain(part.name)}-gaps",
                f"{n} of {len(part.time)} frames without a pose; the longest gap is from "
                f"{longest[0]:.2f} to {longest[1]:.2f} s: {longest[2]}",
            )
        if part.n_outliers:
            yield remark(f"{_plain(part.name)}-outliers", f"{part.n_outliers} poses are outliers")
    if motion is None:
        yield remark("no-actuator", "the path of the drive was not tracked")
    elif not motion.moved:
        detail = f"no steady motion of the drive over {motion.travel * 1e3:.3f} mm"
        yield remark("no-motion", detail)
    missing = {f.name for f in scene.fixels} - {f.name for f in tracked.fixels}
    if missing:
        yield remark("fixels-as-planned", ", ".join(sorted(missing)) + " was not visible")
    for fixel in tracked.fixels:
        if fixel.scatter > RESTLESS:
            scatter = f"its positions scatter by {fixel.scatter * 1e3:.2f} mm"
            detail = f"{scatter}; it may have been hit or hidden"
            yield remark(f"{_plain(fixel.name)}-restless", detail)
    off = float(np.hypot(*(track.trajectory.pose[0] - scene.bodies[0].pose)[:2]))
    if off > MISPLACED:
        detail = f"{track.name} starts {off * 1e3:.1f} mm from its pose in the scene"
        yield remark("starts-elsewhere", detail)
    for index, sentence in enumerate((*tracked.remarks, *remarks)):
        yield remark(f"film-{index + 1}", sentence)


def _plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "-", name.lower()).strip("-") or "p"


def _shifted(trajectory: model.Trajectory, zero: float) -> model.Trajectory:
    return model.Trajectory(time=trajectory.time - zero, pose=trajectory.pose)
