"""Loops as users write them around the package's functions; run as a program, some of them on so many devices.

`python user_loops.py DEVICES NAME ...` prints a line for each loop, with the numbers that it ends at.
"""

import functools
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
import optimistix as optx

from raytrace_jax import RenderSettings, make_residual, parse_scene, render, set_parameters

SETTINGS = RenderSettings(size=(8, 6), max_bounces=0)
INDEX = 1.4
TRUTH = {"board.diffuse.r": 0.5}
SCENE = """
camera eye { pixeldim 8 6 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 6 5 4 emissivity 1 1 1 }
material board { ambient 1 2 3 diffuse 0.7 0.7 0.7 }
material glass { diffuse 0.2 0.2 0.2 alpha 0.8 ior 1.4 }
plane board { material board normal 0 0 1 point 0 0 -4 }
sphere ball { material glass center 4 3 -1 radius 2 }
"""


@functools.cache
def setup():
    """A ball before a board, the residual of its picture with another colour, and a renderer."""
    scene = parse_scene(SCENE)
    target = render(set_parameters(scene, TRUTH), SETTINGS).image
    return scene, make_residual(scene, target, list(TRUTH), SETTINGS), functools.partial(render, settings=SETTINGS)


def loss(y):
    return 0.5 * jnp.sum(setup()[1].residual(y) ** 2)


def steps_by_hand():
    """The issue's loop: what a compiled gradient returns goes back into it."""
    gradient, y = jax.jit(jax.grad(loss)), setup()[1].start
    for _ in range(100):
        y = y - 0.3 * gradient(y)
    return y


def optax_adam():
    optimizer, y = optax.adam(0.02), setup()[1].start
    state = optimizer.init(y)

    @jax.jit
    def step(y, state):
        updates, state = optimizer.update(jax.grad(loss)(y), state, y)
        return optax.apply_updates(y, updates), state

    for _ in range(120):
        y, state = step(y, state)
    return y


def optimistix_levenberg_marquardt():
    """Twice, the second time from where the first one ended."""
    y = setup()[1].start
    for _ in range(2):
        solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
        y = optx.least_squares(setup()[1].residual, solver, y, max_steps=20).value
    return y


def scan_over_steps():
    @jax.jit
    def descend(y):
        return jax.lax.scan(lambda y, _: (y - 0.3 * jax.grad(loss)(y), None), y, length=50)[0]

    return descend(descend(setup()[1].start))


def vmap_over_indices():
    """A batch of pictures, and the same with indices that come from their brightness."""
    scene, _, _ = setup()
    renderer = functools.partial(render, settings=RenderSettings(size=(8, 6), max_bounces=1))
    brightness = jax.jit(jax.vmap(lambda ior: renderer(set_parameters(scene, {"glass.ior": ior})).image.mean()))
    once = brightness(jnp.array([1.2, INDEX, 1.6]))
    return brightness(INDEX + 0 * once)


def renders_of_renders():
    """A picture's colour is a parameter of the next; all of it compiled, and not."""
    scene, _, renderer = setup()

    def brightness(red):
        return renderer(set_parameters(scene, {"board.diffuse.r": red})).image.mean()

    red = jnp.asarray(0.5)
    ends = []
    for function in (brightness, jax.jit(brightness)):
        for _ in range(3):
            red = function(red)
        ends.append(red)
    return jnp.stack(ends)


def scenes_that_follow_their_gradient():
    """All numbers of a scene at once, as with equinox."""
    scene, _, renderer = setup()
    gradient = jax.jit(jax.grad(lambda scene: renderer(scene).image.mean()))
    for _ in range(2):
        scene = eqx.apply_updates(scene, jax.tree.map(lambda slope: -0.01 * slope, gradient(scene)))
    return scene.materials.diffuse


LOOPS = {
    function.__name__: function
    for function in (
        steps_by_hand,
        optax_adam,
        optimistix_levenberg_marquardt,
        scan_over_steps,
        vmap_over_indices,
        renders_of_renders,
        scenes_that_follow_their_gradient,
    )
}

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", int(sys.argv[1]))
    for name in sys.argv[2:]:
        print(name, *(float(x).hex() for x in jnp.ravel(LOOPS[name]())), flush=True)
