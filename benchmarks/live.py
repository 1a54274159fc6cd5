"""What live pictures cost, and how late they are: ``python -m benchmarks.live``.

Frames of the rendered bench at 1280 x 720. Processor time a frame of the overlay; the time from
`LiveView.show` until the last byte of a picture is with a reader on this machine, alone and with
readers that stand still; and until a Chromium has painted it, likewise.
"""

from __future__ import annotations

import http.client
import os
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from fixel.formats.rig_file import rig_of
from fixel.formats.scene_file import load_scene
from fixel.model import Trajectory
from fixel.vision.frame import Frame, Picture, opencv
from fixel.vision.render.film import film_scene
from fixel.vision.render.looks import looks_named
from fixel.web.live import PART_HEAD, LiveView
from fixel.web.live_pages import overlay_page
from fixel.web.serve import WebServer
from fixel.workflows.acquisition.overlay import Overlay, draw_look

Watcher = Callable[[WebServer], Callable[[], list[tuple[int, float]]]]

SCENE = Path(__file__).resolve().parents[1] / "examples" / "scenes" / "peg_slip.yaml"
FRAMES = 60
RATE = 30.0  # [frames/s]
SLOWLY = 5.0  # [frames/s] at which a browser that is one picture late would show it
SHOWN = 90  # pictures a run
BLOCK = 96  # [px] of the corner whose brightness numbers the pictures for the browser
LEVELS = 10  # of that brightness
STANDING = 3  # readers that do not read
SAMPLER = f"""() => {{
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 1;
  const pen = canvas.getContext("2d", {{ willReadFrequently: true }});
  window.seen = [];
  let last = -1;
  const sample = () => {{
    const image = document.querySelector("#picture");
    if (image.naturalWidth) {{
      pen.drawImage(image, 16, 16, {BLOCK - 32}, {BLOCK - 32}, 0, 0, 1, 1);
      const level = Math.round(pen.getImageData(0, 0, 1, 1).data[1] * {LEVELS} / 255);
      if (level !== last) window.seen.push([level, Date.now() / 1000]);
      last = level;
    }}
    requestAnimationFrame(sample);
  }};
  sample();
}}"""


def bench_frames() -> tuple[Overlay, list[Frame]]:
    """The thesis's bench with a part that a hand pushes home."""
    scene, rig = load_scene(SCENE).scene, rig_of("thesis-tags")
    clock = np.arange(FRAMES) / RATE
    off = np.linspace(1.0, 0.0, FRAMES)[:, None] * (0.012, -0.006, 0.15)
    still = np.zeros((FRAMES, 3))
    tracks = {
        "object": Trajectory(time=clock, pose=scene.bodies[0].pose + off),
        "actuator": Trajectory(time=clock, pose=scene.pushers[0].pose + still),
    }
    frames = film_scene(scene, tracks, rig, looks_named("thesis"), clock)
    return Overlay(rig, scene), list(frames)


def processor_time(overlay: Overlay, frames: list[Frame]) -> None:
    """Milliseconds a frame for each part of the work."""
    cv2 = opencv()
    cv2.setNumThreads(1)
    looks, drawn = [], []
    spent = dict.fromkeys(("find", "draw", "compress"), 0.0)
    slowest = 0.0
    for frame in frames:
        fresh = Frame(frame.time, frame.picture)
        begun = time.process_time()
        looks.append(overlay.look(fresh))
        took = time.process_time() - begun
        spent["find"] += took
        slowest = max(slowest, took)
    begun = time.process_time()
    drawn = [draw_look(f.picture, look) for f, look in zip(frames, looks, strict=True)]
    spent["draw"] = time.process_time() - begun
    begun = time.process_time()
    sizes = [len(cv2.imencode(".jpg", p, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]) for p in drawn]
    spent["compress"] = time.process_time() - begun
    for what, seconds in spent.items():
        print(f"{what:9} {1e3 * seconds / len(frames):6.2f} ms of processor a frame")
    print(f"slowest look {1e3 * slowest:.1f} ms; a picture of {np.mean(sizes) / 1e3:.0f} kB")


def delays(pictures: list[Picture], look: Watcher, rate: float = RATE) -> list[float]:
    """[s] from showing a picture until it is seen by a watcher."""
    view, shown = LiveView(), []
    with WebServer([overlay_page(view, "benchmark")]) as server:
        view.show(pictures[0], {})
        ended = look(server)
        for number in range(SHOWN):
            level = 1 + number % (LEVELS - 1)
            picture = pictures[number % len(pictures)].copy()
            picture[:BLOCK, :BLOCK] = round(255 * level / LEVELS)
            shown.append((level, time.time()))
            view.show(picture, {})
            time.sleep(1.0 / rate)
        seen = ended()
    return [at - then for level, then in shown for at in _first(seen, level, then, rate)]


def _first(seen: list[tuple[int, float]], level: int, then: float, rate: float) -> list[float]:
    """When this level was seen first after an instant, unless it was left out."""
    round_trip = (LEVELS - 1) / rate
    return [at for found, at in seen if found == level and then <= at < then + round_trip][:1]


def reader(server: WebServer) -> Callable[[], list[tuple[int, float]]]:
    """A program that reads the stream, decoding no more than it must."""
    seen: list[tuple[int, float]] = []
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    cookie = {"Cookie": f"{server.gate.cookie}={server.gate.session}"}
    connection.request("GET", f"{server.gate.root}/overlay/stream", headers=cookie)
    answer = connection.getresponse()

    def read() -> None:
        cv2 = opencv()
        for jpeg in _parts(answer):
            at = time.time()
            corner = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_8)
            level = float(corner[4 : BLOCK // 8 - 4, 4 : BLOCK // 8 - 4].mean())
            seen.append((round(level * LEVELS / 255), at))

    threading.Thread(target=read, daemon=True).start()
    return lambda: seen


def _parts(answer: http.client.HTTPResponse) -> Iterator[bytes]:
    held = b""
    while data := answer.read1(1 << 16):
        *parts, held = (held + data).split(b"\r\n" + PART_HEAD)
        yield from (part.removeprefix(PART_HEAD) for part in parts)


@contextmanager
def standing_readers(server: WebServer) -> Iterator[None]:
    """Browsers that ask for the stream and read nothing of it."""
    cookie = f"Cookie: {server.gate.cookie}={server.gate.session}"
    way = f"{server.gate.root}/overlay/stream"
    asked = f"GET {way} HTTP/1.1\r\nHost: 127.0.0.1\r\n{cookie}\r\n\r\n".encode()
    sockets = []
    for _ in range(STANDING):
        still = socket.create_connection(("127.0.0.1", server.port))
        still.sendall(asked)
        sockets.append(still)
    try:
        yield
    finally:
        for still in sockets:
            still.close()


def reader_among_standing(server: WebServer) -> Callable[[], list[tuple[int, float]]]:
    """`reader`, with others that stand still."""
    standing = standing_readers(server)
    standing.__enter__()
    seen = reader(server)

    def ended() -> list[tuple[int, float]]:
        standing.__exit__(None, None, None)
        return seen()

    return ended


def chromium(server: WebServer) -> Callable[[], list[tuple[int, float]]]:
    """The page in the browser of this machine."""
    from playwright.sync_api import sync_playwright

    play = sync_playwright().start()
    browser = play.chromium.launch(
        executable_path=shutil.which("chromium"),
        chromium_sandbox=os.geteuid() != 0,
        args=["--disable-background-networking", "--no-first-run", "--disable-gpu"],
    )
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.goto(server.link)
    page.evaluate(SAMPLER)

    def ended() -> list[tuple[int, float]]:
        seen = [(int(level), float(at)) for level, at in page.evaluate("window.seen")]
        browser.close()
        play.stop()
        return seen

    return ended


def _print_delays(what: str, found: list[float]) -> None:
    low, middle, high = 1e3 * np.percentile(found, (5, 50, 95))
    print(f"{what:38} {middle:6.1f} ms ({low:.1f} to {high:.1f}), {len(found)} of {SHOWN} seen")


def main() -> None:
    """All of it."""
    overlay, frames = bench_frames()
    assert all(a.time < b.time for a, b in pairwise(frames))
    processor_time(overlay, frames)
    pictures = [frame.picture for frame in frames]
    _print_delays("to a reader", delays(pictures, reader))
    _print_delays(f"with {STANDING} that stand still", delays(pictures, reader_among_standing))
    if shutil.which("chromium"):
        _print_delays("painted by Chromium", delays(pictures, chromium))
        slowly = delays(pictures, chromium, SLOWLY)
        _print_delays(f"painted by Chromium, {SLOWLY:g} pictures/s", slowly)


if __name__ == "__main__":
    main()
