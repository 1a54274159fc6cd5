"""Films: they play, at the speed they say, and show what moves."""

import av
import numpy as np
import pytest
from PIL import Image

from fixel import InvalidInput, QuasiStatic, simulate
from fixel.drawing.animation import animate_simulation, usual_speed
from fixel.testing import scenes


@pytest.fixture(scope="module")
def run():
    return simulate(scenes.grasp("slip"), duration=2.0)


def test_mp4_plays_in_real_time(run, tmp_path):
    path, seen = tmp_path / "film.mp4", []

    animate_simulation(run, path, progress=lambda p: seen.append((p.done, p.total)))

    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
        assert stream.average_rate == 30
        assert stream.codec_context.pix_fmt == "yuv420p"
    assert len(frames) == 2 * 30 + 1 + 30  # and a second to look at the end
    assert frames[0].shape[0] % 2 == frames[0].shape[1] % 2 == 0
    assert seen[-1] == (len(frames), len(frames))
    middle = np.abs(frames[0].astype(int) - frames[45].astype(int))
    assert (middle > 60).any()


def test_gif_holds_every_frame(run, tmp_path):
    path = tmp_path / "film.gif"
    animate_simulation(run, path, speed=4.0)
    with Image.open(path) as film:
        assert film.n_frames >= 10
        assert film.info["duration"] == 50


def test_a_failed_run_and_a_tiny_one_can_be_filmed(tmp_path):
    jammed = simulate(scenes.grasp("seated", force_limit=None))
    tiny = simulate(scenes.micro_push(), motion=QuasiStatic())
    animate_simulation(jammed, tmp_path / "jammed.mp4", speed=20.0)
    animate_simulation(tiny, tmp_path / "tiny.mp4", speed=20.0)
    assert all(path.stat().st_size > 1000 for path in tmp_path.iterdir())


def test_other_endings_are_refused(run, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.gif, \.mp4"):
        animate_simulation(run, tmp_path / "film.avi")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("duration", "speed"), [(11.0, 1.0), (2.0, 1.0), (0.2, 0.1), (300.0, 10.0), (100.0, 5.0)]
)
def test_long_and_short_motions_get_a_round_factor(duration, speed):
    assert usual_speed(duration) == pytest.approx(speed)
