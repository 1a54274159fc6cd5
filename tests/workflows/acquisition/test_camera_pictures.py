"""Pictures that a camera is calibrated with."""

import numpy as np

from fixel.formats.recording_video import VideoSink
from fixel.formats.video_file import files_of, first_picture, pictures_of


def test_pictures_of_a_recording_are_spread_over_its_length(tmp_path):
    sink = VideoSink(tmp_path / "video.nut", (64, 48), exact=True)
    for k in range(100):
        sink.append_picture(33_333 * k, np.full((48, 64, 3), 2 * k, dtype=np.uint8))
    sink.close()

    shown = [picture.mean() for _, picture in pictures_of(files_of([tmp_path]))]

    np.testing.assert_allclose(shown, 4.0 * np.arange(50), atol=1.0)
    assert first_picture(tmp_path).mean() <= 1.0
