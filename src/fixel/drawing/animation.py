"""Animation of a simulation, in real time or faster or slower by a stated factor.

The fixed background is drawn once. Every frame restores it and draws only bodies, pushers, trails,
forces and the clock. Poses between samples are interpolated; a contact point stays fixed to its
body.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fixel.drawing import palette, view
from fixel.drawing.chart import Style, tint
from fixel.drawing.picture import force_text
from fixel.drawing.top_view import DASHED, add_outlines, fixel_outlines, frame_axes, hollow, solid
from fixel.drawing.view import forces
from fixel.errors import require
from fixel.io.atomic import refuse_ending, written_whole
from fixel.model import placed
from fixel.progress import ProgressOption, show_progress
from fixel.simulation import Simulation
from fixel.typing import FloatArray, ProgressCallback
from fixel.units import DisplayUnit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILM_ENDINGS = (".gif", ".mp4")

RATE = 30  # frames per second of an .mp4
GIF_RATE = 20  # frame times of a .gif are hundredths of a second, and its size grows with frames
PIXELS = (960, 720)  # maximum width and height, even as the video format requires
DPI = 160
THICKNESS = 0.012  # thickness of force arrows, as a share of the larger side of the picture
SHORTEST, LONGEST = 2.0, 30.0  # [s] of animation; other durations are scaled to these


def animate_simulation(
    simulation: Simulation,
    path: str | Path,
    *,
    others: Sequence[Simulation] = (),
    speed: float | None = None,
    progress: ProgressOption = None,
) -> None:
    """Save an animation of a simulation, with the contact forces, as `.mp4` or `.gif`.

    A failed simulation is shown up to where it stopped; `others` of the same bodies are drawn as
    outlines. `speed` is seconds of motion per second of animation: by default 1, or a round factor
    that gives a very long or short motion a watchable length; a factor other than 1 is stated in
    the animation. `progress` is as for `fixel.progress.show_progress`.
    """
    path = Path(path)
    refuse_film(path)
    gif = path.suffix.lower() == ".gif"
    rate = GIF_RATE if gif else RATE
    end = float(simulation.time[-1])
    speed = speed or usual_speed(end)
    times = np.append(np.arange(0.0, end, speed / rate), end)
    times = np.append(times, np.full(rate, end))  # show the end for a second
    with written_whole(path) as temporary, show_progress(progress, "drawing frames") as report:
        frames = _frames(_Stage(simulation, speed, others), times, report)
        (_write_gif if gif else _write_mp4)(temporary, frames, rate)


def refuse_film(path: str | Path) -> None:
    """Raise for a file name that is no film, or one whose format needs a missing package."""
    refuse_ending(path, FILM_ENDINGS, "film")
    if Path(path).suffix.lower() == ".mp4":
        require("av", str(path), extra="video")


def film_ending() -> str:
    """Ending of a film whose user named no file: `.mp4`, or `.gif` without PyAV."""
    return ".gif" if find_spec("av") is None else ".mp4"


def usual_speed(duration: float) -> float:
    """Default speed: 1 for motions of 2 to 30 s, else a round factor that scales to that range."""
    if duration > LONGEST:
        return 1.0 / view.round_number(LONGEST / duration)
    if 0.0 < duration < SHORTEST:
        return view.round_number(duration / SHORTEST)
    return 1.0


def _frames(stage: _Stage, times: FloatArray, report: ProgressCallback) -> Iterator[Any]:
    for k, time in enumerate(times, 1):
        yield stage.frame(float(time))
        report(k, len(times))


class _Stage:
    """Figure with a fixed background, whose moving parts are redrawn for every frame."""

    def __init__(
        self, simulation: Simulation, speed: float, others: Sequence[Simulation] = ()
    ) -> None:
        import matplotlib as mpl
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.simulation = simulation
        self.speed = speed
        self.others = tuple(others)
        boxes = [view.extent(own) for own in (simulation, *others)]
        self.box = view.Rectangle.around(np.concatenate([np.array((b.x, b.y)).T for b in boxes]))
        self.unit = view.unit_for(self.box.size)
        with mpl.rc_context(palette.STYLE):  # type: ignore[arg-type]
            figure, self.axes = _figure(self.box, self.unit)
            self.canvas = FigureCanvasAgg(figure)
            self._draw_fixed()
            self._prepare_moving()
            self.canvas.draw()  # type: ignore[no-untyped-call]
        self.background = self.canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]

    def _draw_fixed(self) -> None:
        scene, pose = self.simulation.scene, self.simulation.pose
        fixel_outlines(self.axes, scene.fixels, (), self.unit, zorder=3)
        starts = [placed(b.shape.outline, pose[b.name][0]) for b in scene.bodies]
        style = hollow(palette.BODY, 0.6, alpha=0.5, linestyle=DASHED, zorder=1)
        add_outlines(self.axes, starts, self.unit, **style)

    def _prepare_moving(self) -> None:
        from matplotlib.collections import LineCollection, PolyCollection

        run = self.simulation
        self.shapes = view.shapes_of(run)
        self.trail_points = [
            view.centre_path(run, b.name) * self.unit.factor for b in run.scene.bodies
        ]
        thin = 0.5 if len(run.scene.bodies) > 8 else 1.0
        self.bodies = PolyCollection([], **solid(tint(palette.BODY, 0.3), palette.BODY, thin))
        self.pushers = PolyCollection([], **solid(palette.PUSHER))
        self.trails = LineCollection([], color=palette.BODY, linewidth=0.8 * thin)
        self.arrows = PolyCollection([], facecolor=palette.FORCE, edgecolor="none")
        title: Style = {"transform": self.axes.transAxes, "va": "bottom"}
        self.clock = self.axes.text(0.0, 1.02, "", color=palette.INK, **title)
        self.note = self.axes.text(1.0, 1.02, "", color=palette.FORCE, ha="right", **title)
        self.touched = PolyCollection([], **solid(palette.TOUCHED))
        self.outlines = PolyCollection([], **hollow(palette.FORCE, 0.5, alpha=0.6, zorder=4))
        drawn = (
            self.bodies, self.pushers, self.trails, self.touched, self.arrows, self.outlines
        )  # fmt: skip
        for artist in drawn:
            self.axes.add_collection(artist, autolim=False)
        self.moving = (*drawn, self.clock, self.note)
        for part in self.moving:
            part.set_animated(True)
        known = run.contacts[np.isfinite(run.contacts["normal_force"])]
        # An impact may exceed all later forces by far, so the scale is a high quantile.
        sizes = np.hypot(*forces(known).T) if len(known) else np.zeros(1)
        self.largest = float(np.quantile(sizes, 0.98))
        self.per_newton = (
            view.arrow_length_per_newton(self.largest, self.box.size) * self.unit.factor
        )

    def frame(self, time: float) -> Any:
        """Draw the frame at a time [s]: (height, width, 4) uint8."""
        run, scale = self.simulation, self.unit.factor
        poses = {name: view.pose_at(run.time, p, time) for name, p in run.pose.items()}
        outlines = {n: placed(self.shapes[n].outline, p) * scale for n, p in poses.items()}
        self.bodies.set_verts([outlines[b.name] for b in run.scene.bodies])
        self.pushers.set_verts([outlines[p.name] for p in run.scene.pushers])
        self.outlines.set_verts([
            placed(body.shape.outline, view.pose_at(own.time, own.pose[body.name], time)) * scale
            for own in self.others for body in run.scene.bodies
        ])  # fmt: skip
        seen = int(np.searchsorted(run.time, time, side="right"))
        self.trails.set_segments([points[:seen] for points in self.trail_points])
        self._set_forces(time)
        factor = "" if self.speed == 1.0 else f"   (film at {self.speed:g} x)"
        stopped = run.stopped_at is not None and time >= run.stopped_at
        self.clock.set_text(f"t = {time:.2f} s{factor}" + (f"   {run.status}" if stopped else ""))
        self.canvas.restore_region(self.background)  # type: ignore[no-untyped-call]
        for artist in self.moving:
            self.axes.draw_artist(artist)
        return np.asarray(self.canvas.buffer_rgba())  # type: ignore[no-untyped-call]

    def _set_forces(self, time: float) -> None:
        run, scale = self.simulation, self.unit.factor
        thick = THICKNESS * self.box.size * scale
        # The contact table has the forces of a step at its end.
        sample = min(int(np.searchsorted(run.time, time)), len(run.time) - 1)
        moment = run.time[sample]
        rows = view.contacts_at(run, moment)
        if time < moment and sample > 0:
            # A gap that closes at the end of this step is still open.
            earlier = view.contacts_at(run, run.time[sample - 1])
            before = {(r["body"], r["other"]) for r in earlier}
            rows = rows[np.array([(r["body"], r["other"]) in before for r in rows], np.bool_)]
        points, _, forces = view.carried(run, rows, time)
        largest, arrows = view.largest_force(forces), []
        for point, force in zip(points, forces, strict=True):
            size = float(np.hypot(*force))
            if 1e-4 * self.largest < size < np.inf:
                # Length grows with the root, so that weak and very strong forces are readable.
                length = min(1.5, sqrt(size / self.largest)) * self.largest * self.per_newton
                arrows.append(_arrow(point * scale, force / size * length, thick))
        self.arrows.set_verts(arrows)
        rounded = force_text(float(f"{largest:.2g}"))
        self.note.set_text(f"largest force {rounded} (arrows: root)" if largest > 0.0 else "")
        touched = {run.names[k] for k in rows["other"]}
        fixels = [f for f in run.scene.fixels if f.name in touched]
        self.touched.set_verts([placed(f.shape.outline, f.pose) * scale for f in fixels])


def _figure(box: view.Rectangle, unit: DisplayUnit) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    left, right, bottom, top = 0.55, 0.12, 0.42, 0.28
    widest, tallest = PIXELS[0] / DPI - left - right, PIXELS[1] / DPI - bottom - top
    aspect = (box.y[1] - box.y[0]) / (box.x[1] - box.x[0])
    width = min(widest, max(tallest / aspect, 0.4 * widest))
    height = min(tallest, max(width * aspect, 0.3 * tallest))
    total = _even(left + width + right), _even(bottom + height + top)
    figure = Figure(figsize=total, dpi=DPI)
    axes = figure.add_axes(
        (left / total[0], bottom / total[1], width / total[0], height / total[1])
    )
    frame_axes(axes, box.with_aspect(height / width), unit)
    return figure, axes


def _even(inches: float) -> float:
    return 2 * round(inches * DPI / 2) / DPI


def _arrow(tail: FloatArray, along: FloatArray, thick: float) -> FloatArray:
    """Outline of an arrow, (7, 2)."""
    length = float(np.hypot(*along))
    ahead = along / length
    aside = np.array([-ahead[1], ahead[0]])
    head = min(3.0 * thick, 0.6 * length)
    neck = tail + (length - head) * ahead
    shaft, barb = 0.3 * thick * aside, 0.4 * head * aside
    left = [tail + shaft, neck + shaft, neck + barb, tail + along]
    return np.array([*left, neck - barb, neck - shaft, tail - shaft])


def _write_mp4(path: Path, frames: Iterator[Any], rate: int) -> None:
    import av

    with av.open(str(path.absolute()), "w") as film:
        stream: Any = None
        for pixels in frames:
            if stream is None:
                stream = _stream(film, rate, pixels.shape[1], pixels.shape[0])
            picture = av.VideoFrame.from_ndarray(pixels, format="rgba")
            film.mux(stream.encode(picture))
        film.mux(stream.encode(None))


def _stream(film: Any, rate: int, width: int, height: int) -> Any:
    """Add a stream in H.264, which every browser plays, or in MPEG-4 if PyAV lacks H.264."""
    import av

    try:
        stream = film.add_stream("libx264", rate=rate, options={"crf": "21", "preset": "veryfast"})
    except (av.FFmpegError, ValueError):
        stream = film.add_stream("mpeg4", rate=rate, options={"q:v": "3"})
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    return stream


def _write_gif(path: Path, frames: Iterator[Any], rate: int) -> None:
    from PIL import Image

    pictures = [Image.fromarray(pixels).convert("RGB") for pixels in frames]
    colours = pictures[len(pictures) // 2].quantize(128, dither=Image.Dither.NONE)
    flat = [p.quantize(palette=colours, dither=Image.Dither.NONE) for p in pictures]
    flat[0].save(
        path, save_all=True, append_images=flat[1:], duration=1000 // rate, loop=0, optimize=False
    )
