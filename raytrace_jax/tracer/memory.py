"""Pictures that cannot fit into memory, refused in words before work begins."""

from raytrace_jax.errors import PictureError
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.aovs import AOVS
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.session import free_memory

BYTES_A_NUMBER = 30
"""Bytes that a channel of a pixel takes when it is rendered and written, in several copies.

Between pictures of 1024 and 2048 pixels a side the peak grows by 34 (OpenEXR), 32 (PNG), 37 (64 bits) and, with a
derivative, 31."""

WORTH_A_LOOK = 4_000_000
"""Pictures of fewer pixels are not checked: to ask how much memory there is takes some fifty microseconds."""


def refuse_too_large(scene: Scene, settings: ResolvedSettings, derivatives: int = 0) -> None:
    """Refuse a picture for which there is no memory.

    Args:
        scene: gives the size, where the settings do not.
        settings: what is rendered.
        derivatives: how many pictures of derivatives there are beside it.

    Raises:
        PictureError: says how much memory is needed and free, and what to do.
    """
    _, _, width, height = settings.window(scene.camera.pixeldim)
    if width * height < WORTH_A_LOOK:
        return
    channels = 3 * (1 + derivatives) + sum(len(AOVS[name].channels) for name in settings.aov)
    needed = BYTES_A_NUMBER * channels * width * height
    free = free_memory()
    if free is not None and needed > free:
        what = (
            f"a picture of {width} x {height} pixels"
            + (derivatives > 0) * f" with derivatives by {derivatives} numbers"
        )
        raise PictureError(
            f"{what} needs about {_gigabytes(needed)} of memory, and {_gigabytes(free)} are free: render it in parts "
            "(--crop), or smaller (--size)."
        )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.3g} GB"
