"""A gallery: its pictures rendered one after the other, and the labelled sheet of them."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.images.options import Transfer
from raytrace_jax.report.gallery_sets import Gallery, Variant
from raytrace_jax.report.gradient_figure import draw_signed, scale_limit
from raytrace_jax.report.panels import as_pixels, remove_ticks
from raytrace_jax.scene.parameters import blocks_of, set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.derivatives import PictureDerivatives, picture_derivatives
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

CELL = 3.6  # inches


def render_gallery(
    scene_of: Callable[[Variant], Scene], gallery: Gallery, settings: ResolvedSettings, wrt: tuple[str, ...] = ()
) -> Iterator[tuple[Variant, Scene, ResolvedSettings, PictureDerivatives]]:
    """Render the pictures of a gallery one after the other, each with the scene and the settings that made it.

    Args:
        scene_of: gives the scene of each; its materials' values change where a variant says so.
        gallery: which pictures.
        settings: for all of them, of the gallery's model; what a variant switches is changed.
        wrt: parameters with respect to which each picture is differentiated, with edges; none gives no derivatives.
    """
    for variant in gallery.variants:
        scene = scene_of(variant)
        names = [block.name for block in blocks_of(scene, "material")]
        changed = {f"{name}.{what}": value for what, value in variant.materials.items() for name in names}
        varied = set_parameters(scene, changed)
        how = dataclasses.replace(settings, **variant.switches)
        if wrt:
            how = dataclasses.replace(how, edges="aware")
            found = picture_derivatives(varied, wrt, how)
        else:
            image = render(varied, how).image
            found = PictureDerivatives(image, (), jnp.zeros((0, *image.shape), image.dtype))
        yield variant, varied, how, found


def draw_gallery(
    titles: Sequence[str], pictures: Sequence[PictureDerivatives], columns: int, transfer: Transfer = "course"
) -> Figure:
    """Draw pictures in rows of `columns`; each derivative has one colour scale for all of them.

    Args:
        titles: one for each picture.
        pictures: all of the same size and with derivatives by the same parameters, or by none.
        columns: how many pictures go into a row.
        transfer: how colours become those of the screen.
    """
    names = pictures[0].names
    _, height, width = pictures[0].image.shape
    bands, rows_each = -(-len(pictures) // columns), 1 + len(names)
    size = CELL * columns, (0.9 * CELL * height / width + 0.3) * bands * rows_each
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    axes = figure.subplots(bands * rows_each, columns, squeeze=False)
    derivatives = [np.asarray(picture.values) for picture in pictures]
    limits = [max(scale_limit(values[k]) for values in derivatives) or 1.0 for k in range(len(names))]
    for place, (title, picture) in enumerate(zip(titles, pictures, strict=True)):
        band, column = divmod(place, columns)
        ax = axes[band * rows_each, column]
        ax.imshow(as_pixels(picture.image, transfer))
        ax.set_title(title, fontsize=9)
        for k, name in enumerate(names):
            ax = axes[band * rows_each + 1 + k, column]
            draw_signed(ax, derivatives[place][k], limits[k], picture.units[k], f"d.{name}")
    remove_ticks(axes.ravel())
    for ax in axes.ravel()[len(pictures) * rows_each :]:
        ax.set_visible(False)
    return figure
