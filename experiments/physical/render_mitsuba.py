"""Renders scenes of `tests/pictured_scenes.py` by Mitsuba 3 in float32, each pixel the mean over its square.

Needs `mitsuba` and `OpenEXR` from PyPI, in an environment of their own. From the repository's root:
python experiments/physical/render_mitsuba.py nested|absorption|sky SAMPLES
"""

import sys
from pathlib import Path

import mitsuba as mi  # pyright: ignore[reportMissingImports]
import numpy as np
import OpenEXR

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))
import pictured_scenes  # noqa: E402
from physical_scenes import Sphere  # noqa: E402

mi.set_variant("scalar_rgb")
EXTERIORS = {"nested": {1: 1.5, 3: 1.5, 4: 1.8}}
"""The index around a ball where it is not 1, by hand, for Mitsuba does not find it: by the number of the shape."""


def bitmap(texels):
    return mi.Bitmap(np.ascontiguousarray(texels))


def rows_at_both_poles(texels):
    """The same sky in 2 h + 1 rows of which the first and the last lie at the poles, as Mitsuba takes them.

    Ours are in the middle of h strips; each of them is one of the new rows, so that linear interpolation loses nothing.
    """
    height = len(texels)
    below = np.clip(np.arange(2 * height + 1) / 2 - 0.5, 0, height - 1)
    first, second = np.floor(below).astype(int), np.ceil(below).astype(int)
    return (texels[first] + texels[second]) / 2


def scene_dict(scene, name):
    camera, (width, height) = scene.camera, scene.camera.pixeldim
    look = mi.ScalarTransform4f().look_at(origin=camera.viewpoint, target=camera.lookat, up=camera.up)
    out = {
        "type": "scene",
        "integrator": {
            "type": "volpath" if name == "absorption" else "path",
            "max_depth": 64,
            "rr_depth": 1000,
        },
        "sensor": {
            "type": "perspective",
            "fov": camera.fov,
            "fov_axis": "x",
            "to_world": look,
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        },
    }
    if scene.sky is None:
        out["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": list(scene.radiance)}}
    else:
        half_a_turn = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
        texels = scene.sky.texels * np.array(scene.radiance, np.float32)
        out["sky"] = {"type": "envmap", "bitmap": bitmap(rows_at_both_poles(texels)), "to_world": half_a_turn}
    for k, shape in enumerate(scene.shapes):
        out[f"shape{k}"] = shape_dict(shape, EXTERIORS.get(name, {}).get(k, 1.0))
    return out


def shape_dict(shape, exterior):
    material = shape.material
    if not isinstance(shape, Sphere):
        normal = np.cross(shape.right, shape.up)
        columns = [[*shape.right, 0], [*shape.up, 0], [*(normal / np.linalg.norm(normal)), 0], [*shape.center, 1]]
        radiance = {
            "type": "bitmap",
            "bitmap": bitmap(material.texture.texels[::-1]),
            "raw": True,
            "wrap_mode": "clamp",
        }
        return {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(np.array(columns, float).T),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": radiance},
        }
    out = {"type": "sphere", "center": list(shape.center), "radius": shape.radius}
    if not material.transmission:
        grey = {"type": "rgb", "value": material.reflectivity}
        return out | {"bsdf": {"type": "conductor", "material": "none", "specular_reflectance": grey}}
    out["bsdf"] = {"type": "dielectric", "int_ior": material.ior, "ext_ior": exterior}
    if any(material.absorption):
        sigma_t = {"type": "rgb", "value": list(material.absorption)}
        out["interior"] = {"type": "homogeneous", "sigma_t": sigma_t, "albedo": 0.0}
    return out


if __name__ == "__main__":
    name, samples = sys.argv[1], int(sys.argv[2])
    scene = mi.load_dict(scene_dict(getattr(pictured_scenes, name)(), name))
    picture = np.array(mi.render(scene, spp=samples, seed=mi.UInt32(1)))[..., :3]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    path = ROOT / "tests" / "physical_pictures" / f"mitsuba_{name}.exr"
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(picture, np.float16)}).write(str(path))
