"""Course model A once more, as plainly as it can be said: one recursion in float64 NumPy, with the course's epsilons.

It shares no code with the package and is written from the model's description alone. Points are rows: (rays, 3).
"""

import dataclasses

import numpy as np

EPSILON = 1e-5
LEAST_COS = 1e-6
MAX_DISTANCE = 100
AIR = 1.000293


@dataclasses.dataclass
class Shape:
    """A sphere has a radius and a `point` in its middle; a plane has a unit `normal`."""

    point: np.ndarray
    normal: np.ndarray | None
    radius: float | None
    ambient: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    alpha: float
    ior: float


class NumpyTracer:
    """Renders a scene of the package, ray by ray, with the package's settings (corner mapping, one sample)."""

    def __init__(self, scene, settings):
        self.settings = settings
        self.camera = scene.camera
        self.shapes = [self._shape(scene, name) for name in scene.shape_order]
        self.lights = list(zip(np.asarray(scene.lights.location).T, np.asarray(scene.lights.emissivity).T, strict=True))

    @staticmethod
    def _shape(scene, name):
        is_sphere = name in scene.spheres.names
        group = scene.spheres if is_sphere else scene.planes
        i = group.names.index(name)
        m, k = scene.materials, group.material[i]
        if is_sphere:
            geometry = np.asarray(group.center)[:, i], None, float(group.radius[i])
        else:
            normal = np.asarray(group.normal)[:, i]
            geometry = np.asarray(group.point)[:, i], normal / np.linalg.norm(normal), None
        colors = (np.asarray(values)[:, k] for values in (m.ambient, m.diffuse, m.specular))
        return Shape(*geometry, *colors, float(m.alpha[k]), float(m.ior[k]))

    def image(self):
        """(height, width, 3), top row first."""
        width, height = self.settings.size or self.camera.pixeldim
        world_width, world_height = np.asarray(self.camera.worlddim)
        x, y = np.meshgrid(np.arange(width), np.arange(height)[::-1])
        target = np.stack([x / (width - 1) * world_width, y / (height - 1) * world_height, 0.0 * x], -1).reshape(-1, 3)
        o = np.broadcast_to(np.asarray(self.camera.viewpoint), target.shape)
        u = (target - o) / np.linalg.norm(target - o, axis=1, keepdims=True)
        return self.trace(o, u, np.zeros(len(o)), 0).reshape(height, width, 3)

    def trace(self, o, u, dis, bounce):
        color = np.zeros_like(o)
        if bounce > self.settings.max_bounces or not len(o):
            return color
        t, nearest = self.nearest_hit(o, u)
        for index, shape in enumerate(self.shapes):
            mine = (nearest == index) & (dis + t <= MAX_DISTANCE)
            if mine.any():
                p = o[mine] + t[mine, None] * u[mine]
                color[mine] = self.shade(shape, p, u[mine], (dis + t)[mine], bounce)
        return color

    def nearest_hit(self, o, u):
        """Distance to the nearest shape (infinity if there is none) and its index."""
        best, nearest = np.full(len(o), np.inf), np.full(len(o), -1)
        for index, shape in enumerate(self.shapes):
            t = self.distance(shape, o, u)
            closer = (t > EPSILON) & (t < best)
            best[closer], nearest[closer] = t[closer], index
        return best, nearest

    def distance(self, shape, o, u):
        """Distance along each ray to one shape; infinity if it is not hit."""
        if shape.radius is None:
            cos = u @ shape.normal
            parallel = np.abs(cos) < LEAST_COS
            t = (shape.point - o) @ shape.normal / np.where(parallel, 1, cos)
            return np.where(parallel | (t <= 0) | (o[:, 2] + t * u[:, 2] > 0), np.inf, t)
        b = np.sum((o - shape.point) * u, 1)
        c = np.sum((o - shape.point) ** 2, 1) - shape.radius**2
        discriminant = b * b - c
        root = np.sqrt(np.maximum(discriminant, 0))
        near, far = -b - root, -b + root
        t = np.where(near < EPSILON, far, near) if self.settings.second_root else near
        return np.where(discriminant > 0, t, np.inf)

    def shade(self, shape, p, u, dis, bounce):
        s = self.settings
        n = (p - shape.point) / shape.radius if shape.radius else np.broadcast_to(shape.normal, p.shape)
        u_n = np.sum(u * n, 1, keepdims=True)
        mirror = u - 2 * u_n * n

        # Steps 2 and 3: ambient and diffuse light.
        color = np.clip(shape.ambient / dis[:, None], 0, 1)
        for location, emissivity in self.lights:
            to_light, r, cos, lit = self.light(location, p, n)
            color = color + np.where(lit, cos / r, 0) * emissivity * shape.diffuse
        color = np.clip(color, 0, 1)

        # Step 4: the mirror ray.
        shiny = shape.specular.any()
        if shiny and s.reflection:
            reflected = self.trace(p, mirror, dis, bounce + 1)
            color = np.clip(shape.diffuse * color + shape.specular * reflected, 0, 1)

        # Step 5: what shines through.
        if shape.alpha > 0:
            through = self.transmitted(shape, p, u, n, u_n, mirror, dis, bounce)
            color = np.clip((1 - shape.alpha) * color + shape.alpha * through, 0, 1)

        # Step 6: highlights.
        if shiny:
            for location, emissivity in self.lights:
                to_light, r, cos, lit = self.light(location, p, n)
                reflected_light = to_light - 2 * cos * n
                lobe = np.sum(reflected_light * -u, 1, keepdims=True) ** 32
                color = np.clip(color + np.where(lit, lobe / r, 0) * emissivity * shape.specular, 0, 1)
        return color

    @staticmethod
    def light(location, p, n):
        r = np.linalg.norm(location - p, axis=1, keepdims=True)
        to_light = (location - p) / r
        cos = np.sum(n * to_light, 1, keepdims=True)
        return to_light, r, cos, (cos > 0) & (cos < 1)

    def transmitted(self, shape, p, u, n, u_n, mirror, dis, bounce):
        s = self.settings
        entering = u_n < 0
        leaving_ratio = shape.ior / AIR if s.eta == "physical" else AIR * shape.ior
        k = np.where(entering, AIR / shape.ior, leaving_ratio)
        toward = np.where(entering, n, -n)
        cos = -np.abs(u_n)
        radicand = 1 - k * k * (1 - cos * cos)
        total = radicand < 0
        bent = k * (u - cos * toward) - np.sqrt(np.maximum(radicand, 0)) * toward
        light = self.trace(p, np.where(total, mirror, bent), dis, bounce + 1)
        if s.reflectance == "schlick":
            r0 = ((shape.ior - 1) / (shape.ior + 1)) ** 2
            c = np.where(entering, -u_n, np.sum(n * bent, 1, keepdims=True))
            reflectance = r0 + (1 - r0) * (1 - c) ** 5
            reflected = self.trace(p, mirror, dis, bounce + 1)
            light = np.where(total, light, (1 - reflectance) * light + reflectance * reflected)
        return light if s.total_internal_reflection else np.where(total, 0, light)
