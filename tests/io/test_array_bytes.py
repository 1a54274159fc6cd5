"""Arrays as bytes: round trip, and bytes that announce more than they have."""

import io
import zipfile

import numpy as np
import pytest

from fixel.io.array_bytes import array_of, arrays_of, bytes_of


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def with_header(**changes: object) -> bytes:
    """Return an .npy file of eight bytes with another header."""
    header = {"descr": "<f8", "fortran_order": False, "shape": (1,)} | changes
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + bytes(8)


def test_arrays_come_back_bit_for_bit() -> None:
    arrays = {
        "a": np.array([[0.1, -0.0], [np.nan, np.inf]]),
        "b": np.array(["x", "three"]),
        "c": np.zeros((0, 3), bool),
        "d": np.array([(1, 2.5)], dtype=[("n", "i8"), ("x", "f8")]),
    }
    found = arrays_of(bytes_of(**arrays))
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes()


@pytest.mark.parametrize("data", [
    with_header(shape=(10**14,)),
    with_header(shape=(2,)),
    with_header(shape=(-1,)),
    with_header(descr="|O", shape=(1,)),
    with_header(descr="<M8[s]"),
    with_header()[:40],
    with_header() + b"more",
    b"\x93NUMPY",
    b"",
])  # fmt: skip
def test_a_header_of_another_size_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="array"):
        array_of(data)


def test_arrays_that_unpack_to_more_are_refused() -> None:
    stream = io.BytesIO()
    np.savez_compressed(stream, a=np.zeros(100_000))
    with pytest.raises(ValueError, match="compressed"):
        arrays_of(stream.getvalue())
    assert array_of(npy(np.zeros(3))).tolist() == [0.0, 0.0, 0.0]


def test_an_interruption_while_a_member_is_opened_is_still_one(monkeypatch):
    """Closing the archive fails then, which must not hide Ctrl-C."""
    real = zipfile.ZipFile.open

    def interrupted(*arguments, **options):
        opened.append(real(*arguments, **options))
        raise KeyboardInterrupt

    opened = []
    monkeypatch.setattr(zipfile.ZipFile, "open", interrupted)
    with pytest.raises(KeyboardInterrupt):
        bytes_of(numbers=np.arange(3))
    opened[0].close()
