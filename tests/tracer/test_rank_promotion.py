"""The public surface where JAX refuses that arrays of several ranks meet, as users have it to find their own slips."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import raytrace_jax as rj
from raytrace_jax.util.compilation import forget_programs

SETTINGS = rj.RenderSettings(size=(12, 9), max_bounces=2)
BALL = """
settings main { model physical }
camera eye { pixeldim 48 36 viewpoint 0.3 0.4 5 lookat 0 0 0 fov 30 }
background sky { radiance 0.2 0.25 0.3 }
texture squares { kind checker color1 0.1 0.1 0.2 color2 0.9 0.8 0.7 square 0.6 }
material board { emission 1 1 1 texture squares }
material glass { transmission 1 ior 1.5 }
rectangle back { material board center 0 0 -2 right 3 0 0 up 0 2 0 }
sphere ball { material glass center 0 0 0 radius 1 }
"""
TINTED = BALL.replace("fov 30", "fov 40 distortion 0.02 0").replace("ior 1.5", "ior 1.5 absorption 0.1 0.2 0.1")
ROOM = f"""{TINTED}
film f {{ vignetting 0.1 blur 0.4 magnification 1.01 gain 1 1.1 1 gamma 0.9 shift 0.2 0.1 distortion 0.01 }}
light lamp {{ location 2 3 4 emissivity 5 5 5 }}
material wall {{ diffuse 0.5 0.4 0.3 }}
plane floor {{ material wall point 0 -1.5 0 normal 0 1 0 }}
"""


@pytest.fixture(autouse=True)
def refused():
    """Nothing that was traced before counts."""
    forget_programs()
    with jax.numpy_rank_promotion("raise"):
        with pytest.raises(ValueError, match="rank_promotion"):
            jnp.add(jnp.ones(3), jnp.ones((2, 3)))
        yield


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "edges"), [("classic", "aware"), ("additive", "point"), ("physical", "point"), ("physical", "aware")]
)
def test_every_model_is_rendered(model, edges):
    scene = rj.parse_scene(ROOM) if model == "physical" else rj.load_scene("vitreous", model=model)
    film = rj.render(scene, dataclasses.replace(SETTINGS, edges=edges))
    assert np.isfinite(film.image).all() and np.ptp(np.asarray(film.image)) > 0


@pytest.mark.slow
def test_a_picture_is_fitted():
    scene, settings = rj.parse_scene(BALL), dataclasses.replace(SETTINGS, edges="point")
    target = np.asarray(rj.render(scene, settings).image)
    assert rj.picture_derivatives(scene, ["ball.ior"], settings).values.shape == (1, 3, 9, 12)
    residual = rj.make_residual(scene, target, ["ball.ior"], settings)
    assert jax.eval_shape(jax.jacfwd(residual.residual), residual.start).shape[-1] == 1
    start = rj.set_parameters(scene, {"ball.ior": 1.51})
    result = rj.fit(start, target, ["ball.ior"], settings, options=rj.FitOptions(search=False))
    assert result["ball.ior"].value == pytest.approx(1.5, abs=1e-4)


def test_formulas_take_many_rays():
    d = jnp.stack([jnp.zeros(4), -jnp.ones(4), jnp.zeros(4)])
    for n in (d, -d):
        assert np.isfinite(rj.optics.refract(d, n, jnp.full(4, 1.5))[0]).all()
        assert np.isfinite(rj.optics.reflect(d, n)).all()
    assert np.isfinite(rj.optics.fresnel_dielectric(np.linspace(0, 1, 4), 1.5)).all()
    assert np.isfinite(rj.optics.prism_deviation(np.linspace(0.5, 1, 4), 1.5, 1.0)).all()
