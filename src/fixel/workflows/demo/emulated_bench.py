"""Record a film as if it took place on a bench."""

from __future__ import annotations

from pathlib import Path

from fixel.model import Scene
from fixel.testbed.emulators.bench import emulated_bench
from fixel.testbed.frame_source import CameraPicture
from fixel.testbed.recorder import RecordingStatus, RecordingSummary
from fixel.workflows.acquisition.record import RecordPlan, record


def record_film(
    film: Path, out: Path, scene: Scene, lead: float, firmware: Path | None
) -> tuple[RecordingSummary, float | None]:
    """Record a film as if it took place on a bench.

    Parameters
    ----------
    film, out : Path
        Folders of the film and of the recording.
    scene : Scene
        Planned scene, from which the drive gets its motion.
    lead : float
        Duration of the rest before the motion [s].
    firmware : Path, optional
        See `emulated_bench`.

    Returns
    -------
    recorded : RecordingSummary
    position : float or None
        Position of the drive at the end [m].
    """
    with emulated_bench(film, firmware) as bench:
        begun = False

        def watch(_: CameraPicture, status: RecordingStatus) -> None:
            nonlocal begun
            if not begun:
                begun = True
                bench.begin(status, scene, lead)

        plan = RecordPlan(
            camera=bench.camera,
            folder=out,
            tactile=bench.tactile,
            rig=str(film / "rig.yaml"),
            scene=film / "scene.yaml",
        )
        recorded = record(plan, watch=watch)
        return recorded, bench.end()
