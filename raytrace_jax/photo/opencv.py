"""OpenCV, which only the commands for photographs need: imported when they run."""

import importlib
from types import ModuleType

from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.text import install


def opencv(purpose: str) -> ModuleType:
    """The module cv2, with the detectors of ChArUco boards.

    Args:
        purpose: what needs it, the start of the message where it is missing.

    Raises:
        RaytraceError: OpenCV is missing, cannot be loaded or is too old; with the command that installs it.
    """
    try:
        cv2 = importlib.import_module("cv2")
    except ModuleNotFoundError:
        raise RaytraceError(f"{purpose} needs OpenCV: {install('photo')}") from None
    except ImportError as cause:  # It is there, but a library of the system that it wants is not.
        raise RaytraceError(f"{purpose} needs OpenCV, which cannot be loaded ({cause}): {install('photo')}") from None
    if not hasattr(getattr(cv2, "aruco", None), "CharucoDetector"):
        version = getattr(cv2, "__version__", "of no version")
        raise RaytraceError(f"{purpose} needs OpenCV 4.10 or newer, and {version} is here: {install('photo')}")
    return cv2
