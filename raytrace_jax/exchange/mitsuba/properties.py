"""Which properties Mitsuba 3's plugins have, so that each one of a file is read, named as lost, or refused."""

from collections.abc import Iterable
from typing import NamedTuple

from raytrace_jax.errors import SceneError
from raytrace_jax.exchange.mitsuba.plugins import Plugin
from raytrace_jax.util.text import did_you_mean


class Properties(NamedTuple):
    """The properties of one kind of plugin.

    Args:
        read: those that the import takes, or names itself where it cannot.
        idle: those that do not change what a long render converges to.
        lost: those that change it and have nothing like them here.
    """

    read: tuple[str, ...] = ()
    idle: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


SHAPE = ("to_world", "flip_normals", "bsdf", "interior", "exterior", "emitter")
ROUGHNESS = ("distribution", "alpha", "alpha_u", "alpha_v")
CAMERA = ("to_world", "fov", "fov_axis", "focal_length", "principal_point_offset_x", "principal_point_offset_y", "film")
CAMERA_IDLE = ("sampler", "shutter_open", "shutter_close")
CAMERA_LOST = ("near_clip", "far_clip", "srf", "medium")
TEXTURE = ("filename", "raw", "filter_type", "wrap_mode", "to_uv")
LIGHT_LOST = ("sampling_weight",)

TABLE: dict[tuple[str, str], Properties] = {
    ("shape", "sphere"): Properties((*SHAPE, "center", "radius"), ("silhouette_sampling_weight",)),
    ("shape", "rectangle"): Properties(SHAPE, ("silhouette_sampling_weight",)),
    ("bsdf", "diffuse"): Properties(("reflectance",)),
    ("bsdf", "dielectric"): Properties(("int_ior", "ext_ior", "specular_reflectance", "specular_transmittance")),
    ("bsdf", "roughdielectric"): Properties(
        ("int_ior", "ext_ior", "specular_reflectance", "specular_transmittance", *ROUGHNESS), ("sample_visible",)
    ),
    ("bsdf", "conductor"): Properties(("material", "eta", "k", "specular_reflectance")),
    ("bsdf", "roughconductor"): Properties(
        ("material", "eta", "k", "specular_reflectance", *ROUGHNESS), ("sample_visible",)
    ),
    ("bsdf", "twosided"): Properties(("bsdf",)),
    ("emitter", "area"): Properties(("radiance",), lost=LIGHT_LOST),
    ("emitter", "point"): Properties(("position", "to_world", "intensity"), lost=LIGHT_LOST),
    ("emitter", "constant"): Properties(("radiance",), lost=LIGHT_LOST),
    ("emitter", "envmap"): Properties(("filename", "scale", "to_world"), ("mis_compensation",), LIGHT_LOST),
    ("texture", "bitmap"): Properties(TEXTURE, ("format", "accel"), ("bitmap", "data")),
    ("texture", "checkerboard"): Properties(("color0", "color1", "to_uv")),
    ("medium", "homogeneous"): Properties(
        ("sigma_t", "albedo", "scale"), ("sample_emitters", "has_spectral_extinction", "phase")
    ),
    ("sensor", "perspective"): Properties(CAMERA, CAMERA_IDLE, CAMERA_LOST),
    ("sensor", "thinlens"): Properties((*CAMERA, "aperture_radius", "focus_distance"), CAMERA_IDLE, CAMERA_LOST),
    ("film", "hdrfilm"): Properties(
        ("width", "height", "pixel_format", "rfilter", "crop_width", "crop_height", "crop_offset_x", "crop_offset_y"),
        ("file_format", "component_format", "sample_border", "compensate"),
    ),
    ("rfilter", "box"): Properties(),
    ("integrator", "path"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
    ("integrator", "volpath"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
    ("integrator", "volpathmis"): Properties(("max_depth", "hide_emitters"), ("rr_depth",)),
}
"""The plugins that the import reads, by tag and kind (Mitsuba 3.7's documentation of plugins)."""


def check_properties(plugins: Iterable[Plugin], path: str, lost: list[str]) -> None:
    """Name the properties of some plugins, and of those within them, that have nothing like them here.

    Of a kind of plugin that is not in the table nothing is said: it is named as a whole where it is not read.

    Raises:
        SceneError: a plugin has a property that Mitsuba's has not; the nearest that it has is named.
    """
    # Each plugin once: those that are referred to stand in several places, and with references to references in many.
    left, seen = list(plugins), set[int]()
    while left:
        plugin = left.pop(0)
        known = TABLE.get((plugin.tag, plugin.kind))
        if known is None or id(plugin) in seen:
            continue
        seen.add(id(plugin))
        called = f"{plugin.tag} {plugin.name or plugin.kind}"
        for key in plugin.values:
            # A second plugin of a role has its number behind it: "bsdf 2".
            name = key.partition(" ")[0]
            if name in known.lost:
                lost.append(f"{called}: {name}")
            elif name not in (*known.read, *known.idle):
                have = (*known.read, *known.lost, *known.idle)
                raise SceneError(
                    f"{path}: {called}: it has no {name}.{did_you_mean(name, have)} There are {', '.join(have)}."
                )
        left += [value for value in plugin.values.values() if isinstance(value, Plugin)]
