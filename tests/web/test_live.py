"""Pictures from one thread to others: every reader gets the newest, and none waits."""

import asyncio
import threading

import numpy as np
import pytest

from fixel.web.live import BOUNDARY, LiveView

PICTURE = np.full((24, 32, 3), 90, dtype=np.uint8)


async def take(stream, n):
    parts = []
    async for part in stream:
        parts.append(part)
        if len(parts) == n:
            break
    await stream.aclose()
    return parts


def test_nothing_is_drawn_without_a_reader():
    view, drawn = LiveView(), []

    def draw():
        drawn.append(1)
        return PICTURE

    for _ in range(5):
        view.show(draw, {})
    assert not drawn
    assert not view.watched


def test_a_picture_is_compressed_once_for_all_who_look():
    view, drawn = LiveView(), []

    def draw():
        drawn.append(1)
        return PICTURE

    view.show(draw, {})
    first, second = view.newest.jpeg(), view.newest.jpeg()
    assert first == second
    assert len(drawn) == 1


def test_the_stream_shows_the_newest():
    view = LiveView()
    for number in range(4):
        view.show(np.full((8, 8, 3), 60 * number, dtype=np.uint8), {"n": number})
    head, part = asyncio.run(take(view.pictures(), 2))
    assert head == f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\n\r\n".encode()
    assert part == view.newest.jpeg() + b"\r\n" + head  # or it is shown one late


def test_a_slow_watcher_misses_pictures_and_lags_by_none():
    """Five pictures come while the watcher is busy with one: it goes on with the last."""
    view = LiveView()

    async def watch():
        stream, reports = view.pictures(), []
        view.show(PICTURE, {"n": 0})
        await anext(stream)
        await anext(stream)
        assert view.watched
        for number in range(1, 6):
            view.show(np.full((8, 8, 3), number, dtype=np.uint8), {"n": number})
        part = await anext(stream)
        assert view.newest.jpeg() in part
        reports.append(view.report)
        view.close()
        with pytest.raises(StopAsyncIteration):
            await anext(stream)
        return reports

    assert asyncio.run(watch()) == ['{"n": 5}']
    assert not view.watched


def test_showing_from_another_thread_wakes_who_waits():
    view = LiveView()
    show = threading.Timer(0.05, view.show, (PICTURE, {"n": 1}))

    async def watch():
        show.start()
        return await view.after(0, patience=5.0)

    assert asyncio.run(watch()).report == '{"n": 1}'


def test_a_status_alone_keeps_the_picture():
    view = LiveView()
    view.show(PICTURE, {"n": 1})
    drawing = view.newest.jpeg
    view.show(None, {"n": 2})
    assert view.newest.jpeg is drawing
    assert view.report == '{"n": 2}'


def test_closing_ends_who_waits():
    view = LiveView()

    async def watch():
        asyncio.get_running_loop().call_later(0.02, view.close)
        return await view.after(0, patience=5.0)

    assert asyncio.run(watch()) is None


def test_showing_does_not_fail_for_a_server_that_has_ended():
    view = LiveView()
    loop = asyncio.new_event_loop()
    loop.close()
    view._waiting[asyncio.Event()] = loop
    view.show(PICTURE, {"n": 1})
    assert view.report == '{"n": 1}'


def test_events_carry_every_newest_status():
    view = LiveView()
    view.show(None, {"n": 1})
    retry, first = asyncio.run(take(view.reports(), 2))
    assert retry.startswith("retry:")
    assert first == 'data: {"n": 1}\n\n'


def test_the_last_words_are_heard():
    view = LiveView()
    view.show(None, {"problems": ["the camera failed"]})
    view.close()
    values = "".join(asyncio.run(take(view.reports(), 3)))
    assert values.index("the camera failed") < values.index("event: end")


def test_a_status_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="JSON"):
        LiveView().show(None, {"error_mm": float("nan")})
