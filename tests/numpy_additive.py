"""Course model B once more, as plainly as it can be said: one ray at a time, in Python floats and NumPy vectors.

It shares no code with the package and is written from the model's description alone.
"""

import numpy as np

OFFSET = 1e-3


class NumpyAdditive:
    """Traces single rays through a scene of the package by the additive model."""

    def __init__(self, scene, depth):
        self.depth = depth
        self.eye = np.asarray(scene.camera.viewpoint)
        self.world = np.asarray(scene.camera.worlddim)
        self.shapes = [self._shape(scene, name) for name in scene.shape_order]
        lights = scene.lights
        self.lights = [
            (np.asarray(lights.location)[:, k], np.asarray(lights.emissivity)[:, k], float(lights.energy[k]))
            for k in range(len(lights.names))
        ]

    @staticmethod
    def _shape(scene, name):
        is_sphere = name in scene.spheres.names
        group = scene.spheres if is_sphere else scene.planes
        i = group.names.index(name)
        material = {
            field: np.asarray(getattr(scene.materials, field))[..., group.material[i]]
            for field in (
                "ambient",
                "diffuse",
                "specular",
                "ior",
                "hardness",
                "reflectivity",
                "fresnel",
                "transmission",
            )
        }
        if is_sphere:
            return "sphere", np.asarray(group.center)[:, i], float(group.radius[i]), material
        normal = np.asarray(group.normal)[:, i]
        return "plane", np.asarray(group.point)[:, i], normal / np.linalg.norm(normal), material

    def image(self, width, height):
        """(3, height, width), top row first."""
        picture = np.zeros((3, height, width))
        for row in range(height):
            for column in range(width):
                u, v = column / (width - 1), (height - 1 - row) / (height - 1)
                target = np.array([u * self.world[0], v * self.world[1], 0.0])
                picture[:, row, column] = self.trace(self.eye, unit(target - self.eye), self.depth)
        return picture

    def trace(self, o, u, depth):
        """The colour that comes along one ray."""
        hit = self.nearest(o, u)
        if hit is None:
            return np.zeros(3)
        t, kind, place, size, m = hit
        p = o + t * u
        n = unit(p - place) if kind == "sphere" else size
        inside = u @ n > 0
        if inside:
            n = -n

        color, reached = np.zeros(3), False
        for location, emissivity, energy in self.lights:
            to_light = location - p
            r = np.linalg.norm(to_light)
            direction = to_light / r
            cos = direction @ n
            blocker = self.nearest(p + OFFSET * n, direction)
            if cos <= 0 or (blocker is not None and blocker[0] < r):
                continue
            reached = True
            intensity = emissivity * energy / r**2
            half = unit(direction - u)
            color += m["diffuse"] * intensity * cos + m["specular"] * intensity * (n @ half) ** m["hardness"]
        if not reached:
            color += m["diffuse"] * m["ambient"]

        r0 = ((1 - m["ior"]) / (1 + m["ior"])) ** 2
        schlick = r0 + (1 - r0) * (1 + u @ n) ** 5
        k_r = (1 - m["fresnel"]) * m["reflectivity"] + m["fresnel"] * schlick
        if depth > 0:
            if k_r > 0:
                color += k_r * self.trace(p + OFFSET * n, u - 2 * (u @ n) * n, depth - 1)
            if m["transmission"] > 0:
                eta = m["ior"] if inside else 1 / m["ior"]
                radicand = 1 - eta**2 * (1 - (u @ n) ** 2)
                if radicand > 0:
                    direction = eta * u - n * (eta * (u @ n) + np.sqrt(radicand))
                    color += (1 - k_r) * m["transmission"] * self.trace(p - OFFSET * n, direction, depth - 1)
        return color

    def nearest(self, o, u):
        """Distance, kind, place, size and material of what a ray meets first, or None."""
        found = []
        for kind, place, size, material in self.shapes:
            if kind == "plane":
                cos = u @ size
                if abs(cos) < 1e-6:
                    continue
                t = (place - o) @ size / cos
                if t > 1e-5 and o[2] + t * u[2] <= 0:
                    found.append((t, kind, place, size, material))
                continue
            b, c = u @ (o - place), (o - place) @ (o - place) - size**2
            if b * b - c <= 0:
                continue
            roots = [t for t in (-b - np.sqrt(b * b - c), -b + np.sqrt(b * b - c)) if t > 1e-5]
            if roots:
                found.append((roots[0], kind, place, size, material))
        return min(found, key=lambda hit: hit[0]) if found else None


def unit(vector):
    return vector / np.linalg.norm(vector)
