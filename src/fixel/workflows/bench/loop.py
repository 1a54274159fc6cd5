"""The loop of a bench: place, check, push, track, accept or repeat, calibrate; row by row."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from fixel.calibration.usual_parameters import searched_unknowns
from fixel.database.project import Project
from fixel.errors import DeviceFailed, FixelError, InvalidInput, JobRefused
from fixel.formats.recording import RIG_FILE, SCENE_FILE, VIDEO
from fixel.formats.rig_file import save_rig
from fixel.formats.scene_file import SceneFile, load_scene, save_scene
from fixel.jobs.worker_process import WorkerProcess
from fixel.model import PlannedExperiment
from fixel.model.space import ParameterSpace
from fixel.table import Table
from fixel.testbed.recorder import (
    Recorder,
    RecordingStatus,
    RecordingSummary,
    check_disk_space,
    free_space,
)
from fixel.typing import FloatArray
from fixel.vision.frame import Frame, Picture
from fixel.workflows.acquisition.overlay import Look, Overlay, Tolerance, draw_look, frames_of
from fixel.workflows.acquisition.record import codec_for
from fixel.workflows.bench.acceptance import BenchFigure, BenchRun, figure_table, measure_bench
from fixel.workflows.bench.campaign import Attempt, Campaign
from fixel.workflows.bench.devices import NO_ZERO, BenchDevices
from fixel.workflows.bench.estimates import LiveAnswer, estimate_rows
from fixel.workflows.bench.judge import TrackedAttempt, track_attempt

LEAD: Final = 0.5  # [s] of recording before the push
REST: Final = 0.8  # [s] of recording after it
BEHIND: Final = 10.0  # [s] for which pictures may wait to be written
IN_PLACE: Final = 5  # looks in a row at a part in place, before a push without being asked
NUDGE: Final = 0.4  # [s] between two corrections of the emulated person
MAX_ATTEMPTS: Final = 3  # with a fault at one row, without being asked
SHOWN: Final = 60  # newest attempts in a status
LIMIT: Final = 900.0  # [s] for one call of another process
TRIES: Final = 5  # of a call whose process died, as one does that is killed for its memory
DARK, LIGHT = 25.0, 235.0  # mean grey levels of pictures that are too dark and too light
Show = Callable[[Callable[[], Picture] | Picture | None, dict[str, Any]], None]
Phase = Literal["placing", "moving", "pushing", "waiting", "trouble", "finished"]


class BenchCheck(NamedTuple):
    """One check before a push."""

    name: str
    passed: bool
    words: str


class Background:
    """Calls of a function in a process of its own, one after the other, without waiting."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._process = WorkerProcess(partial(_called, function), limit=LIMIT)
        self._pool = ThreadPoolExecutor(1)
        self._closed = False
        self._calls: list[Future[None]] = []

    @property
    def waiting(self) -> int:
        """Number of calls whose answer `done` did not get yet."""
        self._calls = [own for own in self._calls if not own.done()]
        return len(self._calls)

    def call(self, done: Callable[[Any], None], *arguments: Any) -> None:
        """Call the function; `done` gets its answer or its error, in another thread."""
        self._calls.append(self._pool.submit(lambda: done(self._answer(arguments))))

    def _answer(self, arguments: tuple[Any, ...]) -> Any:
        """Return the answer or the error of a call, again if its process died."""
        begun = time.monotonic()
        for left in reversed(range(TRIES)):
            try:
                return self._process.call(arguments, lambda: self._closed)
            except Exception as problem:
                late = time.monotonic() - begun > LIMIT
                if late or not left or not isinstance(problem, JobRefused):
                    return problem

    def close(self) -> None:
        """End the process; calls without an answer get none."""
        self._closed = True
        self._pool.shutdown(cancel_futures=True)
        self._process.close()


def _called(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    return function(*arguments)


@dataclass(eq=False)
class BenchLoop:
    """Loop over the rows of a campaign: `run` in one thread, `ask` from any.

    The options are those of `open_bench`.
    """

    project: Project
    campaign: Campaign
    devices: BenchDevices
    _: KW_ONLY
    limit: int | None
    auto: bool
    choose: bool
    until: str
    fit: Sequence[str]
    motion: str
    tolerance: float | None  # [m]
    tolerance_angle: float | None  # [rad]
    dry_run: bool
    check: bool

    def __post_init__(self) -> None:
        # Called with a picture or what draws it, or None, and with the status, as `LiveView.show`.
        self.show: Show | None = None
        # Returns why the page that asked for a push is lost; empty while it is there.
        self.page_left: Callable[[], str] = lambda: ""
        self.begun_by = "key"  # or `page`, which must stay there during a check of the bench
        rig = self.devices.rig
        self._allowed = Tolerance(
            distance=self.tolerance or rig.position_tolerance,
            angle=self.tolerance_angle or rig.angle_tolerance,
        )
        self.live: LiveAnswer | None = None  # newest estimates
        # Why the campaign has ended; empty before.
        self.finish = "the drive can perform every row" if self.dry_run else ""
        self.figures: tuple[BenchFigure, ...] = ()  # measured by a check of the bench
        self._events: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._tracker, self._estimator = Background(track_attempt), Background(estimate_rows)
        self._row: PlannedExperiment | None = None
        self._overlay: Overlay | None = None
        self._look: Look | None = None
        self._checks: tuple[BenchCheck, ...] = ()
        self._trouble, self._remark = "", ""
        self._in_place, self._nudged = 0, -NUDGE
        self._wants_push = ""  # who asked for it: `key` or `page`
        self._pushing, self._stop_reason, self._stops = threading.Event(), "", 0
        self._withdraws: FloatArray | None = None  # where the head goes after its push
        self._outdated = False  # whether the estimates lack an experiment that no call has
        self._tracked_ones: dict[str, TrackedAttempt | Exception] = {}  # by the name of the attempt

    @property
    def limit_reached(self) -> bool:
        """Whether the campaign has as many experiments as it may have."""
        return self.limit is not None and len(self.campaign.accepted) >= self.limit

    # --- from any thread ------------------------------------------------------------------------

    def ask(self, do: str, row: str = "", by: str = "key") -> None:
        """Ask for something by a `key` or a `page`; a stop takes effect at once.

        It may be `push`, `stop`, `place` (the emulated person), `skip`, `again` (after trouble),
        `end`, or for the attempt of a name `accept` or `repeat`.
        """
        if do == "stop":
            self.stop("stopped by the person at the bench")
        asked = self._stops, self._trouble

        def grant() -> None:
            # The head does not move after a stop, or for trouble that the person had not seen.
            if do not in ("push", "again") or asked == (self._stops, self._trouble):
                self._granted(do, row, by)

        self._events.put(grant)

    def stop(self, reason: str) -> None:
        """Stop the drive at once, if it moves; what was asked for before does not move it."""
        self._stops += 1
        self._wants_push = ""
        if self._pushing.is_set():
            self._stop_reason = self._stop_reason or reason
            self.devices.drive.stop()

    # --- the loop -------------------------------------------------------------------------------

    def run(self) -> str:
        """Perform rows until all are done, or enough is known, or someone ends it; return why."""
        frames: Generator[Frame] | None = None
        try:
            self._report("waiting")
            while self.check and not self.finish:
                if not self._in_trouble():
                    self._measure()
            if not self.finish:  # as that of a dry run or a check
                for attempt in self.campaign.undecided:
                    self._track(attempt)
                self._estimate()
            while not self._is_over():
                if self._in_trouble():
                    continue
                frames = frames or self._frames()
                self._tried(partial(self._turn, frames))
                self._stop_reason = ""
                self._pushing.set()
                # A stop before has removed the wish; one from now on stops the drive.
                push = self._row if self._wants_push and not self.finish else None
                if push is None:
                    self._pushing.clear()
                if push is not None or self._trouble:
                    frames.close()  # a push reads its own, and those of a lost camera have ended
                    frames = None
                if push is not None:
                    self._tried(partial(self._perform, push))
            self._report("finished")
        finally:
            if frames is not None:
                frames.close()
            self._tracker.close()
            self._estimator.close()
        return self.finish

    def _frames(self) -> Generator[Frame]:
        camera = self.devices.camera
        patience = camera.patience if self._pushing.is_set() else None
        yield from frames_of(camera.view(), camera.stream.live, patience=patience)

    def _is_over(self) -> bool:
        """Whether nothing is left to do."""
        if self._tracker.waiting or self._pushing.is_set() or not self._events.empty():
            return False
        if not (self.finish or self.campaign.undecided or self._estimator.waiting):
            if not self.campaign.left:
                self.finish = "every row of the plan is done"
            elif self.limit_reached:
                self.finish = "the limit is reached"
        return bool(self.finish)

    def _in_trouble(self) -> bool:
        """Do what was asked for, take what other processes have computed, and show trouble."""
        while not self._events.empty():
            self._tried(self._events.get())
        if not self.devices.drive.zero_known:
            self._trouble = self._trouble or NO_ZERO
        if self._trouble:
            self._report("trouble")
            time.sleep(0.1)
        return bool(self._trouble)

    def _tried(self, do: Callable[[], None]) -> None:
        """Do something; its error, such as that of a full disk or a locked database, is trouble."""
        try:
            do()
        except FixelError as problem:
            words = f"{problem}. No recording is lost. Remove the cause, then try again (key a)"
            self._trouble, self._wants_push = self._trouble or words, ""  # no push later, either

    def _turn(self, frames: Iterator[Frame]) -> None:
        """Look at one picture for the present row, which is chosen if there is none."""
        if self._row is None:
            self._begin_row(self._next_row())
        frame = next(frames, None)
        if why := self._drive_trouble() or self.devices.board_trouble:
            self._trouble = why
        elif frame is None:
            self._trouble = f"the camera stopped: {self.devices.camera.lost}"
        elif self._overlay is None:
            self._report("waiting", frame.picture)
            if self.devices.laboratory is not None:
                time.sleep(0.1)  # rendering would take the processors of what is waited for
        else:
            look = self._overlay.look(frame)
            draw = partial(draw_look, frame.picture, look)
            # The head is not to be placed: the drive moves it to its start.
            heads = self._row.scene.pushers if self._row else ()
            own = tuple(p for p in look.parts if p.name not in [head.name for head in heads])
            look = self._look = look._replace(parts=own)
            self._checks = tuple(self._checked(look, frame))
            self._report("placing", draw)
            if self.auto:
                self._without_asking(look)

    def _next_row(self) -> PlannedExperiment | None:
        """Return the row to perform next; None while it is not known, or there is none."""
        left = self.campaign.left
        if not left or self.finish:
            return None
        coming = len(self.campaign.accepted) + len(self.campaign.undecided)
        if self.limit is not None and coming >= self.limit:
            return None
        if self.choose and self._estimator.waiting + self._tracker.waiting:
            return None
        chosen = self.live.chosen if self.choose and self.live else ""
        return next((row for row in left if row.name == chosen), left[0])

    def _begin_row(self, row: PlannedExperiment | None) -> None:
        self._row, self._overlay, self._look, self._checks = row, None, None, ()
        self._in_place, self._wants_push = 0, ""
        if row is None:
            return
        if self.devices.laboratory is not None:
            self.devices.laboratory.prepare(row, len(self.campaign.of(row.name)))
        self._overlay = Overlay(
            self.devices.rig, row.scene, self._allowed, anchor=self._anchor(row)
        )

    def _anchor(self, row: PlannedExperiment) -> str:
        """Return the head, if the place of the drive in the world is not known but seen."""
        head = row.scene.pushers[0].name
        seen = self.devices.frame is None and head in self.devices.rig.parts
        return head if seen else ""

    def _without_asking(self, look: Look) -> None:
        self._in_place = self._in_place + 1 if all(own.passed for own in self._checks) else 0
        if self._in_place >= IN_PLACE:
            self._wants_push = "key"
        elif not look.placed and self.devices.clock() - self._nudged > NUDGE:
            self._granted("place")

    def _granted(self, do: str, name: str = "", by: str = "key") -> None:
        """Do what was asked for, if it is possible now."""
        attempt = self.campaign.attempts.get(name)
        ready = self._checks and not self._trouble and all(one.passed for one in self._checks)
        if do == "push" and ready:
            self._wants_push = by
        elif do == "place" and self.devices.laboratory is not None:
            self._nudged = self.devices.clock()
            self.devices.laboratory.nudge()
        elif do == "skip" and self._row is not None:
            self.campaign.skip(self._row.name)
            self._begin_row(None)
        elif do == "accept" and attempt is not None and attempt.state == "tracked":
            self._accept(attempt)
        elif do == "repeat" and attempt is not None and attempt.state in ("tracked", "accepted"):
            self.campaign.note(attempt, "repeated")
            if attempt.state == "accepted":
                self._estimate()
        elif do == "again" and self._trouble:
            self._recover(by)
        elif do == "end":
            self.finish = self.finish or "ended by the person at the bench"

    # --- checks ---------------------------------------------------------------------------------

    def _checked(self, look: Look, frame: Frame) -> Iterator[BenchCheck]:
        """Yield the checks before a push."""
        assert self._row is not None
        unseen = [part for part in look.checked if part.measured is None]
        words = ", ".join(f"{part.name}: {part.reason}" for part in unseen) or "all seen"
        yield BenchCheck("markers", not unseen and not look.problems, words)
        yield BenchCheck("in place", look.placed, look.sentence)
        if self.devices.tactile is not None and self._row.scene.fixels:
            reading = self.devices.tactile.read()
            words = reading.problem or ("no reading" if reading.bits is None else "read")
            yield BenchCheck("fixels", reading.bits is not None, words)
        grey = float(frame.luma[::8, ::8].mean())
        words = "too dark: add light" if grey < DARK else "good"
        words = "too bright: reduce light or exposure" if grey > LIGHT else words
        yield BenchCheck("light", DARK <= grey <= LIGHT, words)
        clear = self._way(self._row, look) is not None
        yield BenchCheck("drive", clear, "ready" if clear else "the part is in the way of the head")
        yield self._disk_check()

    def _disk_check(self) -> BenchCheck:
        stream, folder = self.devices.camera.stream, self.campaign.folder
        try:  # as the recorder does
            check_disk_space(folder, stream, codec_for("auto", stream), None)
        except InvalidInput as full:
            words = f"{full.found}, but needs {full.expected}; {full.hint}"
            return BenchCheck("disk", False, words)
        return BenchCheck("disk", True, f"{free_space(folder) / 1e9:.1f} GB free")

    def _way(self, row: PlannedExperiment, look: Look) -> list[FloatArray] | None:
        """Return the way of the head to the start of a push, past the part where it is seen."""
        part = next(own for own in look.parts if own.name == row.scene.bodies[0].name)
        return self.devices.way_to(row.scene, part.measured)

    def _drive_trouble(self) -> str:
        """Return why the drive cannot push, with what `_recover` does about it; empty if it can."""
        try:
            state = self.devices.drive_state
        except FixelError as problem:
            return f"the drive does not answer: {problem}"
        words = f"the drive is in the state {state}. Remove the cause, then try again (key a)"
        return "" if state == "Idle" else words

    def _measure(self) -> None:
        """Measure the bench with the part of the first row."""
        campaign, done = self.campaign, []
        with self.project.store() as store:
            for own in campaign.accepted:
                scene = load_scene(campaign.recording(own) / SCENE_FILE).scene
                assert own.experiment is not None
                found = store.experiment(own.experiment)
                done.append(BenchRun(campaign.by_name[own.row], scene, found))
        self._begin_row(campaign.rows[0])
        assert self._overlay is not None
        self._pushing.set()
        self._report("moving")  # every key stops it, and its page gives signs of life
        try:
            self.figures = measure_bench(
                self.devices, self._overlay, done,
                lambda way, *seen: self._moved(way, self.begun_by, *seen),
            )  # fmt: skip
        finally:
            self._pushing.clear()
            self._begin_row(None)
        self.finish = "the bench was measured"

    # --- a push ---------------------------------------------------------------------------------

    def _perform(self, row: PlannedExperiment) -> None:
        """Push once, recorded; then track it while the next part is placed."""
        assert self._look is not None
        assert self._overlay is not None
        scene, by = self._overlay.scene, self._wants_push
        way = self._way(row, self._look)
        assert way is not None
        attempt = self.campaign.begin(row.name)
        try:
            self._moved(way, by)
            self._withdraws = self.devices.withdrawn(row.scene)
            done = self._recorded(replace(row, scene=scene), self.campaign.recording(attempt), by)
            if done.early:
                raise DeviceFailed(done.reason)
            attempt = self.campaign.note(attempt, "recorded")
            self._track(attempt)
            self._moved([self._withdraws], by)
            self._withdraws = None
        except FixelError as failure:
            self._trouble = self._stop_reason or str(failure)
            if attempt.state == "begun":
                self.campaign.note(attempt, "stopped", reasons=(self._trouble,))
        finally:
            self._pushing.clear()
            self._begin_row(None)

    def _recorded(self, row: PlannedExperiment, folder: Path, by: str) -> RecordingSummary:
        """Record while the drive performs its stroke."""
        camera, newest, end = self.devices.camera, -math.inf, math.inf

        def prepare(place: Path) -> None:
            save_rig(self.devices.rig, place / RIG_FILE)
            save_scene(SceneFile(scene=row.scene), place / SCENE_FILE)

        def watch(arrived: Any, status: RecordingStatus) -> None:
            nonlocal newest
            newest = arrived.taken
            self._report("pushing", arrived.picture, status)

        def over() -> str:  # once the pictures that wait to be written are written
            late = self.devices.clock() > end + BEHIND
            return "the push is over" if late or newest >= end else ""

        recorder = Recorder(
            source=camera.view(),
            stream=camera.stream,
            folder=folder,
            codec=codec_for("auto", camera.stream),
            tactile=self.devices.tactile,
            patience=camera.patience,
            rig=self.devices.rig.name,
            stop=over,
            watch=watch,
            prepare=prepare,
        )

        def lost() -> str:  # why the recording has ended
            if not recording.done():
                return ""
            return str(recording.exception() or recording.result().reason)

        with ThreadPoolExecutor(1, "fixel-recorder") as pool:
            recording = pool.submit(recorder.run)
            try:
                while newest == -math.inf and not recording.done():
                    time.sleep(0.005)
                if not recording.done():
                    self.devices.sleep(LEAD)
                    self._stroke(row, lost, by)
                    self.devices.sleep(REST)
            finally:
                end = self.devices.clock()
            return recording.result()

    def _stroke(self, row: PlannedExperiment, lost: Callable[[], str], by: str) -> None:
        """Move the head along its stroke; stop it if the recording ends or the page is lost."""
        drive, push = self.devices.drive, self.devices.stroke(row.scene)
        drive.aim(push.start, push.direction)
        self._refuse_stopped()

        def watch() -> None:
            if why := lost():
                self.stop(why)
            self._watch_page(by)
            time.sleep(0.005)

        self._watched(partial(drive.move, to=push.travel, speed=push.speed), watch)

    def _watched(self, move: Callable[[], None], watch: Callable[[], None]) -> None:
        """Move in another thread, and call `watch` until it is done; an error stops the drive."""
        with ThreadPoolExecutor(1, "fixel-drive") as pool:
            moving = pool.submit(move)
            try:
                while not moving.done():
                    watch()
                    if self._stop_reason:  # also where the stop came just before the move
                        self.devices.drive.stop()
            except BaseException:
                self.stop("the program was interrupted")
                raise
            if self._stop_reason and isinstance(moving.exception(), FixelError):
                raise DeviceFailed(self._stop_reason)
            moving.result()

    def _refuse_stopped(self) -> None:
        """Raise if a stop was asked for, or the position was lost, before the head moves."""
        if why := self._stop_reason or ("" if self.devices.drive.zero_known else NO_ZERO):
            raise DeviceFailed(why)

    def _moved(
        self,
        places: list[FloatArray],
        by: str,
        seen: Callable[[Frame], None] = lambda frame: None,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        """Move the head through places, and show the pictures meanwhile."""

        def ready() -> None:
            self._refuse_stopped()
            before()

        frames = self._frames()

        def watch() -> None:
            frame = next(frames, None)
            if frame is None:
                self.stop(f"the camera was lost: {self.devices.camera.lost}")
                time.sleep(0.005)
                return
            seen(frame)
            self._report("moving", lambda: frame.picture)
            self._watch_page(by)

        with closing(frames):
            self._watched(partial(self.devices.go, places, ready), watch)

    def _watch_page(self, by: str) -> None:
        """Stop the drive if the page that asked for the push is lost."""
        if by == "page" and (why := self.page_left()):
            self.stop(why)

    # --- after a push ---------------------------------------------------------------------------

    def _track(self, attempt: Attempt) -> None:
        """Track a recorded attempt in another process."""
        self._tracker.call(
            lambda found: self._events.put(partial(self._tracked, attempt, found)),
            self.campaign.recording(attempt), self.campaign.by_name[attempt.row], attempt.number,
            self.campaign.folder.name, self._allowed,
        )  # fmt: skip

    def _tracked(self, attempt: Attempt, found: TrackedAttempt | Exception) -> None:
        """Take a tracked attempt, which is accepted if nothing speaks against it."""
        self._tracked_ones[attempt.name] = found
        reasons = (str(found),) if isinstance(found, Exception) else found.reasons
        attempt = self.campaign.note(attempt, "tracked", reasons=reasons)
        if not reasons:
            self._accept(attempt)
        elif self.auto:
            self.campaign.note(attempt, "repeated")
            faulty = [own for own in self.campaign.of(attempt.row) if own.state == "repeated"]
            if len(faulty) >= MAX_ATTEMPTS:  # those that were stopped had no fault
                self.campaign.skip(attempt.row)

    def _accept(self, attempt: Attempt) -> None:
        """Store an attempt as an experiment of the project; the same again changes nothing."""
        found = self._tracked_ones.get(attempt.name)
        if not isinstance(found, TrackedAttempt):
            self._remark = f"{attempt.name} cannot be tracked; repeat it"
            return
        with self.project.store() as store:
            video = store.add_video(self.campaign.recording(attempt) / VIDEO)
            number = store.add_experiment(replace(found.experiment, video=video)).id
        self.campaign.note(attempt, "accepted", experiment=number)
        self._estimate()

    def _estimate(self) -> None:
        """Calibrate all accepted experiments in another process."""
        ids = [own.experiment for own in self.campaign.accepted if own.experiment is not None]
        self._outdated = self._estimator.waiting > 1  # `_learned` asks again
        self.live = self.live if ids else None
        if not ids or self._outdated:
            return
        with self.project.store() as store:
            experiments = [store.experiment(number) for number in ids]
        scenes = [own.scene for own in experiments if own.scene is not None]
        fit = searched_unknowns(self.fit, scenes)
        self._estimator.call(
            lambda found: self._events.put(partial(self._learned, ids, found)),
            experiments, ParameterSpace(unknowns=tuple(fit)) if fit else None, self.motion,
            self.until, self.campaign.left, self.choose,
            None if self.live is None else self.live.estimates,
        )  # fmt: skip

    def _learned(self, ids: list[int], found: LiveAnswer | Exception) -> None:
        """Take the estimates from experiments, unless one of these is to be repeated meanwhile."""
        if self._outdated:
            self._estimate()
        if not {*ids} <= {own.experiment for own in self.campaign.accepted}:
            return
        if isinstance(found, Exception):
            self._remark = f"no estimates yet: {found}"
            return
        self.live, self._remark = found, ""
        self.finish = self.finish or found.finish

    # --- trouble --------------------------------------------------------------------------------

    def _recover(self, by: str) -> None:
        """Open lost devices again, home a drive whose position is lost, or withdraw the head."""
        self._stop_reason = ""
        self._pushing.set()
        self._report("moving")  # every key stops it
        try:
            if self.devices.camera.lost:
                self.devices.camera.restart()
            self.devices.recover_board()
            at_zero = self._trouble == NO_ZERO
            homed = self.devices.recover_drive(at_zero, self._refuse_stopped)
            if self._withdraws is not None and not (at_zero or homed):
                self._moved([self._withdraws], by)
            self._withdraws = None
        except FixelError as problem:
            self._trouble = str(problem)
        else:
            self._trouble = ""
            for attempt in self.campaign.undecided:  # what an error prevented
                if attempt.name in self._tracked_ones and not attempt.reasons:
                    self._tracked(attempt, self._tracked_ones[attempt.name])
        finally:
            self._pushing.clear()

    # --- status ---------------------------------------------------------------------------------

    def _report(
        self,
        phase: Phase,
        draw: Callable[[], Picture] | Picture | None = None,
        recording: RecordingStatus | None = None,
    ) -> None:
        """Show a picture and the whole status, as plain values."""
        campaign, live = self.campaign, self.live
        number = 0 if self._row is None else 1 + list(campaign.by_name).index(self._row.name)
        status: dict[str, Any] = {
            "campaign": campaign.folder.name,
            "phase": phase,
            "emulated": self.devices.laboratory is not None,
            "rows": len(campaign.rows),
            "row": "" if self._row is None else self._row.name,
            "number": number,
            "accepted": len(campaign.accepted),
            "skipped": len(campaign.skipped),
            "problems": [self._trouble] if self._trouble else [],
            "remark": self._remark,
            "finish": self.finish,
            "look": self._look and self._look.summary(),
            "checks": [check._asdict() for check in self._checks],
            "tracking": self._tracker.waiting,
            "attempts": [
                own._asdict() | {"name": own.name} for own in [*campaign.attempts.values()][-SHOWN:]
            ],
            "figures": _columns_and_rows(figure_table(self.figures)) if self.figures else None,
            "estimates": live
            and _columns_and_rows(live.table)
            | {
                "words": live.words,
                "seconds": round(live.seconds, 2),
                "experiments": len(live.estimates.held_out),
            },
            "recording": recording
            and recording._asdict() | {"seconds": round(recording.seconds, 2)},
        }
        if self.show is not None:
            self.show(draw, status)


def _columns_and_rows(table: Table) -> dict[str, Any]:
    """Return a table for a status."""
    return {"columns": [column.head for column in table.columns], "rows": table.rows}
