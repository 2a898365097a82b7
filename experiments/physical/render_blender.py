"""Renders the ball of `fits.py` by Blender's Cycles: a linear EXR and an 8-bit sRGB PNG.

    blender -b --python experiments/physical/render_blender.py -- FOLDER

Needs the program `blender` (Debian package `blender`, tried with 3.4.1), in whose own Python it runs. Cycles samples at
random: its pixels are means of 4096 samples over the whole pixel.
"""

import math
import sys
from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]

WIDTH, HEIGHT, FOV = 160, 120, 40.0
SAMPLES = 4096
IOR, CENTER, RADIUS = 1.473, (0.12, -0.07, 0.15), 1.0
BOARD_Z, BOARD_SIDE = -2.5, 12.0
SQUARE, OFFSET = 0.8, (0.13, 0.07)
FIRST, SECOND, SKY = (0.1, 0.15, 0.25), (0.9, 0.85, 0.8), (0.05, 0.06, 0.08)


def emission(material):
    """Nodes and links of a material that sends out light alone, and the node that does."""
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shader, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    links.new(shader.outputs[0], output.inputs["Surface"])
    return nodes, links, shader


def board():
    bpy.ops.mesh.primitive_plane_add(size=BOARD_SIDE, location=(0, 0, BOARD_Z))
    material = bpy.data.materials.new("board")
    nodes, links, shader = emission(material)
    checker, shift, place = (nodes.new(f"ShaderNode{kind}") for kind in ("TexChecker", "VectorMath", "NewGeometry"))
    # Half a square into the checker's third axis, where no rounding decides.
    shift.operation = "SUBTRACT"
    shift.inputs[1].default_value = (*OFFSET, BOARD_Z + SQUARE / 2)
    links.new(place.outputs["Position"], shift.inputs[0])
    links.new(shift.outputs[0], checker.inputs["Vector"])
    checker.inputs["Scale"].default_value = 1 / SQUARE
    for name, colour in (("Color1", FIRST), ("Color2", SECOND)):
        checker.inputs[name].default_value = (*colour, 1)
    links.new(checker.outputs["Color"], shader.inputs["Color"])
    bpy.context.object.data.materials.append(material)


def ball():
    # Cycles has no spheres: so many facets, with the normals of a sphere, leave 1e-5 of the radius.
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=8, radius=RADIUS, location=CENTER)
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("glass")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    shader, output = nodes.new("ShaderNodeBsdfGlass"), nodes.new("ShaderNodeOutputMaterial")
    shader.distribution = "SHARP"
    shader.inputs["IOR"].default_value = IOR
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    links.new(shader.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)


def camera_and_sky(scene):
    camera = bpy.data.cameras.new("eye")
    camera.sensor_fit, camera.angle = "HORIZONTAL", math.radians(FOV)
    eye = bpy.data.objects.new("eye", camera)
    eye.location = (0, 0, 5)
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*SKY, 1)


def settings(scene):
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.filter_size = 1.0
    cycles = scene.cycles
    cycles.pixel_filter_type = "BOX"
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = SAMPLES, False, False
    cycles.max_bounces = cycles.transmission_bounces = cycles.glossy_bounces = 24
    cycles.blur_glossy, cycles.sample_clamp_indirect = 0, 0
    cycles.caustics_refractive = cycles.caustics_reflective = True


def save(folder):
    image, view = bpy.context.scene.render.image_settings, bpy.context.scene.view_settings
    result = bpy.data.images["Render Result"]
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGB"
    result.save_render(str(folder / "blender_ball.exr"))
    image.file_format, image.color_depth, view.view_transform = "PNG", "8", "Standard"
    result.save_render(str(folder / "blender_ball.png"))


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    board()
    ball()
    camera_and_sky(bpy.context.scene)
    settings(bpy.context.scene)
    bpy.ops.render.render()
    save(Path(sys.argv[sys.argv.index("--") + 1]).resolve())
