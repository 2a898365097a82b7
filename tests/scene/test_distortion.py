"""The perspective camera's principal point and distortion, against OpenCV's formula in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import camera_rays, resolved

import raytrace_jax as rj
from raytrace_jax.scene.lens import undistorted_factor
from raytrace_jax.tracer.geometry.camera import ray

rays_of = jax.jit(camera_rays, static_argnames="settings")
WIDTH, HEIGHT = 64, 48
FOLDS = (-0.9, 0.0)
LENSES = [(0.0, 0.0), (-0.28, 0.07), (0.35, 0.0), (0.4, 0.9), (0.3, -0.08), (-0.1, 0.0), (-0.6, 0.3)]


def camera(center=(31.5, 23.5), distortion=(0, 0), fov=70, dtype=jnp.float64):
    center, distortion = (" ".join(map(repr, values)) for values in (center, distortion))
    text = f"camera eye {{ pixeldim {WIDTH} {HEIGHT} viewpoint 1 2 6 lookat 0.5 0 -1 up 0.2 1 0.1 fov {fov}"
    return rj.parse_scene(f"{text} center {center} distortion {distortion} }}", dtype=dtype)


def project(points, center, distortion, fov=70):
    """Pixels (x, y) of points as OpenCV's pinhole model has them: `x` to the right, `y` down, `z` ahead."""
    eye, forward = np.array([1, 2, 6.0]), np.array([-0.5, -2, -7])
    ahead = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.2, 1, 0.1])
    right /= np.linalg.norm(right)
    x, y, z = np.stack([right, np.cross(ahead, right), ahead]) @ (points - eye).T
    x, y = x / z, y / z
    square = x * x + y * y
    factor = 1 + distortion[0] * square + distortion[1] * square**2
    focal_length = WIDTH / (2 * np.tan(np.radians(fov) / 2))
    return focal_length * factor * x + center[0], focal_length * factor * y + center[1]


@pytest.mark.parametrize("distortion", LENSES)
@pytest.mark.parametrize(("dtype", "bound"), [(jnp.float64, 1e-12), (jnp.float32, 2e-6)])
def test_rays_hit_what_opencv_projects(distortion, dtype, bound):
    center = (20.25, 30.5)
    points = np.random.default_rng(0).uniform([-3, -2, -2], [4, 3, 2], (400, 3))
    column, row = project(points, center, distortion)
    is_shown = (column >= -0.5) & (column <= WIDTH - 0.5) & (row >= -0.5) & (row <= HEIGHT - 0.5)
    assert is_shown.sum() > 200
    places = [jnp.asarray(x, dtype) for x in (column, row)]  # Of all points: one program for all lenses.
    scene = camera(center, distortion, dtype=dtype)
    rays = rays_of(scene.camera, resolved(mapping="center"), *places)
    toward = points[is_shown].T - np.array([[1], [2], [6]])
    wanted = toward / np.linalg.norm(toward, axis=0)
    np.testing.assert_allclose(np.asarray(rays.d)[:, is_shown], wanted, atol=bound)
    # In a picture of another size the principal point is at the same share of it.
    twice = resolved(mapping="center", size=(2 * WIDTH, 2 * HEIGHT))
    larger = rays_of(scene.camera, twice, *(2 * place + 0.5 for place in places))
    np.testing.assert_allclose(np.asarray(larger.d)[:, is_shown], np.asarray(rays.d)[:, is_shown], atol=bound)


def test_the_inverse_is_exact():
    """Distortions of every kind, up to 99 % of the radius at which they fold over and far beyond the unit of others."""
    random = np.random.default_rng(2)
    angle, power = random.uniform(0, 2 * np.pi, 4000), random.uniform(-3, 3, 4000)
    distortion = np.stack([np.cos(angle) * 10**power, np.sin(angle) * 100**power])
    for dtype, bound in ((np.float64, 1e-11), (np.float32, 1e-3)):
        k1, k2 = distortion.astype(dtype).astype(np.float64)
        folds = [np.roots([5 * b, 3 * a, 1]) for a, b in zip(k1, k2, strict=True)]
        real = [roots.real[(roots.imag == 0) & (roots.real > 0)] for roots in folds]
        fold = np.array([min([*roots, 10 / 10**p]) for roots, p in zip(real, power, strict=True)])
        square = fold * 0.98 * random.uniform(size=4000)
        factor = 1 + k1 * square + k2 * square**2
        shown = jnp.asarray(square * factor**2, dtype)
        found = jax.jit(jax.vmap(undistorted_factor, (1, 0)))(jnp.asarray(distortion, dtype), shown)
        np.testing.assert_allclose(np.asarray(found, np.float64) * factor, 1, atol=bound)


def test_directions_have_lens_derivatives():
    """At some place and at the principal point itself, with and without distortion, of first and second order."""
    scene = camera((20.25, 30.5))
    names = ["eye.center.x", "eye.center.y", "eye.distortion.k1", "eye.distortion.k2"]

    @jax.jit
    def direction(x):
        eye = rj.set_parameters(scene, dict(zip(names, x[:4], strict=True))).camera
        return ray(eye, x[4:5], x[5:])[1][:, 0]

    def differences(function, x, step=1e-5):
        return np.stack([(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(6)], axis=-1)

    forward, reverse = jax.jit(jax.jacfwd(direction)), jax.jit(jax.jacrev(direction))
    twice = [jax.jit(jax.jacfwd(reverse)), jax.jit(jax.jacrev(forward))]
    for k1, k2 in ((0.0, 0.0), (-0.28, 0.07), (0.4, 0.9)):
        for u, v in ((0.1, 0.8), (20.75 / WIDTH, 1 - 31 / HEIGHT)):
            x = jnp.asarray([20.25, 30.5, k1, k2, u, v])
            first, second = differences(direction, x), differences(forward, x)
            for derivative in (forward, reverse):
                np.testing.assert_allclose(derivative(x), first, atol=1e-8)
            for derivative in twice:
                np.testing.assert_allclose(derivative(x), second, atol=1e-6)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("distortion", [FOLDS, (1e30, -1e38), (-1e-30, 0.0), (-2.0, 20 / 9), (1e-40, 0.0)])
def test_traced_distortion_is_held_at_folds(distortion, dtype):
    eye = camera(dtype=dtype).camera
    u, v = (jnp.asarray(x.ravel(), dtype) for x in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 7)))

    def directions(values):
        changed = type(eye)(eye.name, eye.pixeldim, eye.viewpoint, eye.lookat, eye.up, eye.fov, eye.center, values)
        return ray(changed, u, v)[1]

    values = jnp.asarray(distortion, dtype)
    with jax.debug_nans(True):
        assert np.all(np.isfinite(jax.jit(directions)(values)))
        assert np.all(np.isfinite(jax.jit(jax.jacfwd(directions))(values)))


def test_a_folding_distortion_is_refused():
    scene = camera()
    corner = np.hypot(32, 24) / 32 * np.tan(np.radians(35))
    fold = np.sqrt(1 / (3 * 0.9))
    message = f"at {100 * fold * 2 / 3 / corner:.4g} % of the way from center to the farthest corner"
    for make, error in (
        (lambda: camera(distortion=FOLDS), rj.ModelFileError),
        (lambda: rj.set_parameters(scene, {"eye.distortion": FOLDS}), rj.ParameterError),
        (lambda: rj.set_parameters(camera(distortion=(-0.15, 0)), {"eye.fov": 120}), rj.ParameterError),
        (lambda: rj.set_parameters(camera(distortion=(-0.15, 0)), {"eye.center.x": -40}), rj.ParameterError),
    ):
        with pytest.raises(error, match="distortion must not fold the picture over, but it does at"):
            make()
    with pytest.raises(rj.ParameterError) as caught:
        rj.set_parameters(scene, {"eye.distortion.k1": -0.9})
    assert message in str(caught.value)
    eye = {"pixeldim": (4, 3), "viewpoint": (0, 0, 5), "lookat": (0, 0, 0), "fov": 70}
    with pytest.raises(rj.SceneError, match="camera 'eye', distortion must not fold"):
        rj.make_scene(rj.build.camera("eye", **eye, distortion=FOLDS))


def test_the_default_center_is_not_written():
    text = "camera eye { pixeldim 5 4 viewpoint 0 0 5 lookat 0 0 0 fov 40 }"
    scene = rj.parse_scene(text)
    assert scene.camera.center.tolist() == [2, 1.5] and scene.camera.distortion.tolist() == [0, 0]
    assert "center" not in rj.format_scene(scene) and "distortion" not in rj.format_scene(scene)
    changed = rj.set_parameters(scene, {"eye.center.y": 1.25, "eye.distortion.k2": 0.1})
    lines = [line.strip() for line in rj.format_scene(changed).splitlines()]
    assert lines[-3:] == ["center 2 1.25", "distortion 0 0.1", "}"]
    assert rj.format_scene(rj.parse_scene(rj.format_scene(changed))) == rj.format_scene(changed)
    with pytest.raises(rj.ParameterError, match="distortion has no component 'x', its components are k1, k2"):
        scene["eye.distortion.x"]
