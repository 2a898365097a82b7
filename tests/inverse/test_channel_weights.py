"""Weights of channels in a whole fit: what has no weight does not count, neither in the value nor in its error."""

import numpy as np
import pytest

from raytrace_jax import (
    FitOptions,
    ParameterError,
    PictureError,
    RenderSettings,
    fit,
    make_residual,
    parse_scene,
    render,
    set_parameters,
    write_png,
)

SCENE = parse_scene("""settings main { model physical max_bounces 2 }
camera eye { pixeldim 24 18 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
texture squares { kind checker color1 0.1 0.15 0.25 color2 0.9 0.85 0.8 square 0.5 offset 0.13 0.07 }
material board { emission 1 1 1 texture squares }
material crown { transmission 1 ior 1.5 }
rectangle backdrop { material board center 0 0 -2.5 right 6 0 0 up 0 6 0 }
sphere ball { material crown center 0.12 -0.07 0.15 radius 1 }
""")
AREAS = RenderSettings(edges="aware")


def picture(index):
    return np.array(render(set_parameters(SCENE, {"crown.ior": index}), AREAS).image)


@pytest.mark.slow
def test_a_channel_without_weight_moves_nothing():
    """Blue is of another ball. The index is that of red and green; the mean of the weights gave 1.51957."""
    target = picture(1.52)
    target[2] = picture(1.518)[2]
    target += 0.002 * np.random.default_rng(0).standard_normal(target.shape)
    weight = np.ones(target.shape)
    weight[2] = 0
    result = fit(
        SCENE, target, ["crown.ior"], options=FitOptions(search=False, target_sampling="aware"), weights=weight
    )
    assert result["crown.ior"].value == pytest.approx(1.52, abs=1e-4)
    assert result.status == "converged" and result.uncertainty.sigma == pytest.approx(0.002, rel=0.15)
    np.testing.assert_array_equal(result.weights, weight)


def test_a_residual_is_weighted_per_channel():
    weight = np.ones((3, 18, 24))
    weight[0], weight[2] = 4, 0
    plain, weighted = (make_residual(SCENE, picture(1.52), ["crown.ior"], AREAS, weights=one) for one in (None, weight))
    residual, found = (np.asarray(one.residual(one.start)) for one in (plain, weighted))
    np.testing.assert_allclose(found, np.sqrt(weight) * residual, rtol=1e-12, atol=1e-15)
    assert np.abs(found[0]).max() > 0.1 and not found[2].any()


@pytest.mark.parametrize("y", [np.ones(1), np.ones((2, 2)), 1.0, np.ones(5), "a", np.ones(2) + 0j])
def test_unknowns_of_another_shape_are_refused(y):
    residual = make_residual(SCENE, picture(1.52), ["crown.ior", "ball.radius"], AREAS)
    for method in (residual.residual, residual.parameters, residual.scene_at):
        with pytest.raises(ParameterError, match=r"the unknowns have the shape|the row of unknowns is"):
            method(y)


def test_channels_of_different_sizes(tmp_path):
    with pytest.raises(PictureError, match=r"of one shape, \(height, width\), and R has \(4, 5\), G has \(3, 5\)"):
        write_png(tmp_path / "a.png", {"R": np.ones((4, 5)), "G": np.ones((3, 5)), "B": np.ones((4, 5))})
