"""One table for each kind of thing: the names that one has, the others know; and the most shapes that there may be."""

from typing import get_args

import jax.numpy as jnp
import pytest
from scenes import assignment_scene

from raytrace_jax import RaytraceError, RenderSettings, parse_scene, render
from raytrace_jax.inverse.linearize import LOSSES
from raytrace_jax.inverse.options import LossName
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES, SHAPE_KEYWORDS
from raytrace_jax.tracer.geometry.camera import DIRECTIONS
from raytrace_jax.tracer.geometry.rays import MOST_SHAPES
from raytrace_jax.tracer.geometry.shape_types import SHAPE_TYPES
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.settings import AOVS, MODEL_RULES
from raytrace_jax.tracer.shading.models import MODELS
from raytrace_jax.tracer.world import prepare_world


def test_tables_know_the_same_names():
    assert set(SHAPE_TYPES) == set(SHAPE_KEYWORDS)
    assert {kind.struct for kind in BLOCK_TYPES["camera"]} == set(DIRECTIONS)
    assert set(MODELS) == set(MODEL_RULES) == set(get_args(ModelName))
    assert set(LOSSES) == set(get_args(LossName))


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", AOVS)
def test_every_variable_has_a_channel_for_each_component(name):
    film = render(assignment_scene(), RenderSettings(size=(8, 6), max_bounces=0, aov=(name,)))
    assert film.aov[name].shape[-2:] == (6, 8)
    assert film.aov[name].reshape(-1, 6, 8).shape[0] == len(AOVS[name].channels)
    assert film.aov[name].dtype == (jnp.int32 if AOVS[name].channels[0].endswith(".I") else film.image.dtype)


@pytest.mark.slow
def test_more_shapes_than_edges_can_tell_apart_are_refused():
    head = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 } material m { } "
    spheres = [f"sphere s{k} {{ material m center 0 0 -{k + 2} radius 1 }}" for k in range(MOST_SHAPES + 1)]
    scene = parse_scene(head + " ".join(spheres))
    prepare_world(scene, ResolvedSettings())
    with pytest.raises(RaytraceError, match="4095 shapes; edge-aware tracing takes 4094"):
        render(scene, RenderSettings(edges="aware"))
    prepare_world(parse_scene(head + " ".join(spheres[:-1])), ResolvedSettings(edges="aware"))
