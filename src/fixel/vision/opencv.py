"""Optional import of OpenCV."""

from __future__ import annotations

from typing import Any

from fixel.errors import InvalidInput


def opencv() -> Any:
    """Return the package cv2; raise with the command to install it if missing."""
    try:
        import cv2
    except ImportError:
        raise InvalidInput(
            "opencv",
            found="the package is not installed",
            expected="OpenCV, which reads cameras and boards",
            hint="pip install 'fixel[vision]'",
        ) from None
    return cv2
