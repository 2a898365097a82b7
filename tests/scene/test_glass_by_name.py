"""A material by the name of its glass is the material with the three indices of the catalogue."""

import pytest
from scenes import assert_same_scene

from raytrace_jax import ModelFileError, SceneError, build, format_scene, glass, make_scene, parse_scene
from raytrace_jax.tracer.world import channel_indices

TEXT = """camera eye {{ pixeldim 4 4 viewpoint 0 0 5 lookat 0 0 0 }}
material lens {{ transmission 1 {} }}
sphere ball {{ material lens center 0 0 0 radius 1 }}"""
INDICES = tuple(float(n) for n in glass.named("N-BK7").index((610.0, 550.0, 465.0)))
IOR = "ior " + " ".join(map(repr, INDICES))


def parsed(words):
    return parse_scene(TEXT.format(words), model="physical")


@pytest.mark.parametrize("words", ['glass "N-BK7"', "glass N-BK7", 'glass "SCHOTT N-BK7"', "glass schott_n-bk7"])
def test_a_name_is_three_indices(words):
    scene = parsed(words)
    assert_same_scene(scene, parsed(IOR))
    assert format_scene(scene) == format_scene(parsed(IOR)) and "glass" not in format_scene(scene)
    assert channel_indices(scene)[:, 0] == pytest.approx(INDICES)


def test_a_common_name():
    water, entry = (parsed(f'glass "{name}"') for name in ("water", "Daimon-20.0C H2O"))
    assert_same_scene(water, entry)
    assert channel_indices(water)[1, 0] == pytest.approx(1.3347, abs=5e-4)


def test_in_python():
    lens = {"transmission": 1, "glass": "N-BK7"}
    rest = [build.camera("eye", pixeldim=(4, 4), viewpoint=(0, 0, 5), lookat=(0, 0, 0))]
    rest += [build.sphere("ball", material="lens", center=(0, 0, 0), radius=1)]
    assert_same_scene(make_scene(build.material("lens", **lens), *rest, model="physical"), parsed(IOR))
    with pytest.raises(SceneError, match="Did you mean 'N-BK7'"):
        make_scene(build.material("lens", glass="N-BK8"), *rest)
    for more in ({"ior": 1.5}, {"ior": (1.5, 1.5, 1.5)}, {"abbe": 60}):
        for values in (lens | more, more | lens):
            with pytest.raises(SceneError, match="glass"):
                make_scene(build.material("lens", **values), *rest)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("glass N-BK8", r"2:38: in material 'lens', .*Did you mean 'N-BK7'"),
        ("glass N-BK7 abbe 60", "mixes two kinds"),
        ("ior 1.5 glass N-BK7", "mixes two kinds"),
        ("glass N-BK7 ior 1 1 1", "both ior and glass"),
        ("glass", "takes the name of a material of the catalogue"),
    ],
)
def test_errors_point_at_the_word(words, message):
    with pytest.raises(ModelFileError, match=message):
        parsed(words)
