"""OpenCV, where it is installed."""

from __future__ import annotations

from typing import Any

from fixel.errors import InvalidInput


def opencv() -> Any:
    """The package cv2, or what to install."""
    try:
        import cv2
    except ImportError:
        raise InvalidInput(
            "opencv",
            found="it is not installed",
            expected="the package that reads cameras and boards",
            hint="pip install 'fixel[vision]'",
        ) from None
    return cv2
