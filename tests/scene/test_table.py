"""Tables: the rows of blocks name things that exist, and the names that one table has, the others know."""

import dataclasses
import inspect
from typing import get_args

import numpy as np
import pytest

from raytrace_jax import Scene
from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.linearize import LOSSES
from raytrace_jax.scene.schema import PICTURE_MIDDLE
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES, SHAPE_KEYWORDS
from raytrace_jax.tracer.geometry.camera import DIRECTIONS
from raytrace_jax.tracer.geometry.shape_types import SHAPE_TYPES
from raytrace_jax.tracer.level import MODELS
from raytrace_jax.tracer.settings import MODEL_RULES

KINDS = [kind for kinds in BLOCK_TYPES.values() for kind in kinds]


def test_every_field_of_a_scene_has_its_rows():
    fields = [field.name for field in dataclasses.fields(Scene)]
    assert fields[-2:] == ["shape_order", "further_views"]
    assert list(dict.fromkeys(kind.group for kind in KINDS)) == fields[1:-2]
    assert SHAPE_KEYWORDS == ("plane", "sphere", "rectangle", "box", "prism", "cylinder", "lens", "slab")


@pytest.mark.parametrize("kind", KINDS)
def test_a_row_fits_its_struct_and_itself(kind):
    names = [attribute.name for attribute in kind.attributes]
    own = "name" if kind.is_single else "names"
    made = ["texels"] if any(attribute.value_type == "file" for attribute in kind.attributes) else []
    assert sorted(field.name for field in dataclasses.fields(kind.struct)) == sorted([own, *names, *made])
    for check in kind.checks:
        assert set(inspect.signature(check).parameters) <= set(names)
    for attribute in kind.attributes:
        assert set(attribute.quantity.sized_by) <= set(names)
        assert bool(attribute.quantity.sized_by) == (attribute.quantity.scale == "block")
        assert attribute.name in BLOCK_TYPES or attribute.value_type != "name"
        assert (attribute.value_type == "word") == bool(attribute.choices)
        assert attribute.value_type != "number" or not attribute.is_optional, "a number that is not there is no number"
        defaults = [attribute.default, *attribute.model_defaults.values()]
        if attribute.default == PICTURE_MIDDLE:
            assert "pixeldim" in kind.required("classic") and not attribute.only
            defaults[0] = attribute.default_of("classic", {"pixeldim": (4, 3)}.__getitem__)
        for values in filter(None, defaults):
            if attribute.is_text:
                assert values in attribute.choices
            else:
                assert len(values) == attribute.value_count and attribute.violation(np.array(values)) is None
    assert ("material" in names) == kind.is_shape
    assert set(kind.textures) <= {texture.group for texture in BLOCK_TYPES["texture"]}


def test_kinds_of_one_keyword_are_told_apart():
    for kinds in BLOCK_TYPES.values():
        assert len({(kind.keyword, kind.is_single, kind.is_shape) for kind in kinds}) == 1
        assert len({kind.group for kind in kinds}) == (1 if kinds[0].is_single else len(kinds))
        for kind in kinds:
            for other in [other for other in kinds if other is not kind]:
                # By an attribute that only one of them has or needs, by another word, or by as many numbers.
                own, its = ({a.name: a for a in one.attributes} for one in (kind, other))
                shared = [(own[name], its[name]) for name in own.keys() & its.keys()]
                needs = [set(one.required("classic")) for one in (kind, other)]
                told = needs[0] - its.keys() or needs[1] - own.keys()
                assert told or any((a.choices, a.shape) != (b.choices, b.shape) for a, b in shared)


def test_attributes_share_their_components():
    """As far as it has as many: tables of batches know attributes by their names and numbers of values."""
    components = {}
    for kind in KINDS:
        for attribute in kind.attributes:
            key = attribute.name, attribute.value_count
            assert components.setdefault(key, attribute.components) == attribute.components


def test_tables_know_the_same_names():
    assert set(SHAPE_TYPES) | {"slabs"} == {kind.group for kind in KINDS if kind.is_shape}
    assert {kind.struct for kind in BLOCK_TYPES["camera"]} == set(DIRECTIONS)
    assert set(MODELS) == set(MODEL_RULES) == set(get_args(ModelName))
    assert set(LOSSES) == set(get_args(LossName))
