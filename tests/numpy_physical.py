"""The physical model once more, as plainly as it can be said: waves of rays through lists of shapes, NumPy and float64.

It shares no code with the package and is written from the model's description alone; `physical_scenes` has its scenes.
"""

import numpy as np
from physical_scenes import Image, Plane, Rectangle, Sphere

CHANNELS = np.array([610.0, 550.0, 465.0])
LINE_D, LINE_F, LINE_C = 587.56, 486.13, 656.27


def picture(scene, samples=1):
    """(3, height, width), top row first: the mean of samples x samples rays on a grid in each pixel."""
    width, height = scene.camera.pixeldim
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    places = (np.arange(samples) + 0.5) / samples - 0.5
    total = sum(look(scene, x + dx, y + dy) for dx in places for dy in places)
    return np.moveaxis(total, -1, 0) / samples**2


def look(scene, x, y):
    """The radiance (..., 3) at places (...) of the picture; (0, 0) is the centre of the upper left pixel."""
    x, y = np.broadcast_arrays(x, y)
    direction = camera_directions(scene.camera, x.ravel(), y.ravel())
    origin = np.broadcast_to(vector(scene.camera.viewpoint), direction.shape)
    iors = np.array([channel_iors(shape.material) for shape in scene.shapes] + [[1.0] * 3])
    if (iors == iors[:, :1]).all():
        light = trace(scene, iors[:, 0], origin, direction, np.ones(3))
    else:
        light = sum(trace(scene, iors[:, c], origin, direction, np.eye(3)[c]) for c in range(3))
    return light.reshape(*x.shape, 3)


def camera_directions(camera, x, y):
    """Unit vectors (n, 3)."""
    width, height = camera.pixeldim
    cx, cy = camera.center or ((width - 1) / 2, (height - 1) / 2)
    forward = unit(vector(camera.lookat) - vector(camera.viewpoint))
    right = unit(np.cross(forward, vector(camera.up)))
    up = np.cross(right, forward)
    pixel = 2 * np.tan(np.radians(camera.fov) / 2) / width
    x, y = (x - cx) * pixel, (y - cy) * pixel
    distorted = np.hypot(x, y)
    factor = undistorted(distorted, *camera.distortion) / np.where(distorted > 0, distorted, 1)
    return unit(forward + (factor * x)[:, None] * right - (factor * y)[:, None] * up)


def undistorted(distorted, k1, k2):
    """The radius r, by bisection, of which r (1 + k1 r^2 + k2 r^4) is given; of several the smallest."""
    turning = np.roots([5 * k2, 3 * k1, 1])  # where the derivative vanishes, in r^2
    turning = turning[(abs(turning.imag) < 1e-12) & (turning.real > 0)].real
    low, high = np.zeros_like(distorted), np.full_like(distorted, np.sqrt(turning.min()) if len(turning) else 1e3)
    for _ in range(80):
        r = (low + high) / 2
        below = r * (1 + k1 * r**2 + k2 * r**4) < distorted
        low, high = np.where(below, r, low), np.where(below, high, r)
    return (low + high) / 2


def channel_iors(material):
    """Three indices: of 610, 550 and 465 nm by n = A + B / lambda^2 if there is an Abbe number."""
    if material.abbe is None:
        return np.broadcast_to(np.array(material.ior, float), 3)
    b = (material.ior - 1) / material.abbe / (LINE_F**-2 - LINE_C**-2)
    return material.ior + b * (CHANNELS**-2 - LINE_D**-2)


def trace(scene, ior, origin, direction, weight):
    """The radiance (n, 3) that rays see, times a weight (3,); `ior` holds each shape's and, last, the outside's.

    Rays go in waves, all of one wave having bounced equally often. A medium is a shape's number, or -1 for the outside.
    """
    absorption = np.array([vector(shape.material.absorption) for shape in scene.shapes] + [np.zeros(3)])
    rank, light = ranks(scene), np.zeros((len(origin), 3))
    # What a wave carries: rays, weights, the pixel they count for and the shape they start on.
    wave = origin, direction, np.tile(weight, (len(origin), 1)), np.arange(len(origin)), np.full(len(origin), -1)
    for _ in range(scene.max_bounces + 1):
        origin, direction, weight, pixel, start = wave
        t = distances(scene, origin, direction, start)
        nearest = np.where(np.isfinite(t.min(axis=0)), t.argmin(axis=0), -1)
        t = t.min(axis=0)
        children = []
        missed = nearest == -1
        np.add.at(light, pixel[missed], weight[missed] * background(scene, direction[missed]))
        for k, shape in enumerate(scene.shapes):
            hit = nearest == k
            if not hit.any():
                continue
            material, d = shape.material, direction[hit]
            p = origin[hit] + t[hit, None] * d
            outward = normals(shape, p)
            inside = dot(d, outward) > 0
            n = np.where(inside[:, None], -outward, outward)

            outer = medium(scene, p, k)
            inner = outer
            if material.transmission > 0:
                inner = np.where(rank[outer] < rank[k], outer, k)
            here, there = np.where(inside, inner, outer), np.where(inside, outer, inner)
            w = weight[hit] * np.exp(-absorption[here] * t[hit, None])
            np.add.at(light, pixel[hit], w * own_light(scene, k, p, n))

            reflected, refracted, r = split(d, n, ior[here] / ior[there])
            share = material.transmission
            for child, part in (
                (reflected, share * r + (1 - share) * material.reflectivity),
                (refracted, share * (1 - r)),
            ):
                children.append((p, child, w * part[:, None], pixel[hit], np.full(hit.sum(), k)))
        if not children:
            break
        wave = [np.concatenate(parts) for parts in zip(*children, strict=True)]
        largest = wave[2].max(axis=1)
        wave = [part[(largest > 0) & (largest >= scene.least_weight)] for part in wave]
    return light


def split(d, n, eta):
    """Reflected and refracted directions and Fresnel's R, for normals turned to the ray; eta is index here / there."""
    cos = -dot(d, n)
    radicand = 1 - eta**2 * (1 - cos**2)
    total = radicand <= 0
    cos_t = np.sqrt(np.where(total, 0, radicand))
    r_s = (eta * cos - cos_t) / (eta * cos + cos_t)
    r_p = (cos - eta * cos_t) / (cos + eta * cos_t)
    r = np.where(total, 1, (r_s**2 + r_p**2) / 2)
    refracted = eta[:, None] * d + (eta * cos - cos_t)[:, None] * n
    same = eta == 1
    return d + 2 * cos[:, None] * n, np.where(same[:, None], d, refracted), np.where(same, 0, r)


def own_light(scene, k, p, n):
    """What a surface sends out by itself and by the lights that shine on it."""
    shape, material = scene.shapes[k], scene.shapes[k].material
    texture = 1 if material.texture is None else surface_texture(shape, p)
    lit = np.zeros_like(p)
    for lamp in scene.lights:
        away = vector(lamp.location) - p
        r = np.sqrt(dot(away, away))
        cos = np.maximum(dot(away, n) / r, 0)
        between = distances(scene, p, away / r[:, None], np.full(len(p), k)) < r
        passed = np.array([shape.material.transmission for shape in scene.shapes])[:, None]
        visible = np.where(between, passed, 1).prod(axis=0)
        lit += (visible * cos / r**2)[:, None] * vector(lamp.emissivity)
    return texture * (vector(material.emission) + (1 - material.transmission) * vector(material.diffuse) / np.pi * lit)


def medium(scene, p, left_out):
    """The glass that decides at points, one shape left out."""
    rank, decided = ranks(scene), np.full(len(p), -1)
    for k, shape in enumerate(scene.shapes):
        if k == left_out or shape.material.transmission == 0 or isinstance(shape, Rectangle):
            continue
        if isinstance(shape, Sphere):
            holds = np.linalg.norm(p - vector(shape.center), axis=1) < shape.radius
        else:
            holds = dot(p - vector(shape.point), vector(shape.normal)) < 0
        decided = np.where(holds & (rank[k] < rank[decided]), k, decided)
    return decided


def ranks(scene):
    """Of two media the one of lower rank decides: the smaller shape, on a tie the first, last the outside."""
    radius = [getattr(shape, "radius", np.inf) for shape in scene.shapes]
    order = sorted(range(len(radius)), key=lambda k: (radius[k], k))
    return np.append(np.argsort(order), len(radius))


def distances(scene, origin, direction, start):
    """(shapes, rays): how far it is to each shape, infinity where it is not met."""
    return np.array([distance(s, origin, direction, start == k) for k, s in enumerate(scene.shapes)])


def distance(shape, origin, direction, starts):
    """How far it is to one shape; a ray that starts on it meets it again only through a sphere."""
    if isinstance(shape, Sphere):
        to = origin - vector(shape.center)
        b = dot(to, direction)
        radicand = shape.radius**2 - dot(to - b[:, None] * direction, to - b[:, None] * direction)
        root = np.sqrt(np.maximum(radicand, 0))
        t = np.where(-b - root > 0, -b - root, -b + root)
        t = np.where((radicand > 0) & (t > 0), t, np.inf)
        return np.where(starts, np.where(b < 0, -2 * b, np.inf), t)
    point = vector(shape.point if isinstance(shape, Plane) else shape.center)
    n = normals(shape, origin)
    cos = dot(direction, n)
    t = dot(point - origin, n) / np.where(cos == 0, 1, cos)
    t = np.where((cos != 0) & (t > 0) & ~starts, t, np.inf)
    if isinstance(shape, Rectangle):
        u, v = halves(shape, origin + np.where(np.isfinite(t), t, 0)[:, None] * direction)
        t = np.where((abs(u) <= 1) & (abs(v) <= 1), t, np.inf)
    return t


def normals(shape, p):
    """Outward normals of spheres; of a plane its own, of a rectangle right x up."""
    if isinstance(shape, Sphere):
        return unit(p - vector(shape.center))
    own = vector(shape.normal) if isinstance(shape, Plane) else np.cross(vector(shape.right), vector(shape.up))
    return np.broadcast_to(unit(own), p.shape)


def halves(shape, p):
    """Places on a rectangle, from -1 to 1 along each of its sides."""
    to, right, up = p - vector(shape.center), vector(shape.right), vector(shape.up)
    return to @ right / (right @ right), to @ up / (up @ up)


def surface_texture(shape, p):
    texture = shape.material.texture
    if isinstance(texture, Image):
        u, v = halves(shape, p)
        height, width, _ = texture.texels.shape
        x, y = (u + 1) / 2 * width - 0.5, (1 - v) / 2 * height - 0.5
        if texture.filter == "nearest":
            return texels(texture.texels, np.floor(x + 0.5), np.floor(y + 0.5), texture.wrap, texture.wrap)
        return bilinear(texture.texels, x, y, texture.wrap, texture.wrap)
    if isinstance(shape, Plane):
        n = unit(vector(shape.normal))
        right = np.cross([0.0, 1.0, 0.0], n)
        right = np.array([1.0, 0, 0]) if np.linalg.norm(right) < 1e-6 else unit(right)
        to, up = p - vector(shape.point), np.cross(n, right)
    else:
        to, right, up = p - vector(shape.center), unit(vector(shape.right)), unit(vector(shape.up))
    x, y = ((to @ axis - shift) / texture.square for axis, shift in zip((right, up), texture.offset, strict=True))
    even = (np.floor(x) + np.floor(y)) % 2 == 0
    return np.where(even[:, None], vector(texture.color1), vector(texture.color2))


def background(scene, direction):
    """The radiance of what a ray sees that hits nothing: the sky's middle lies along -z, its right half to +x."""
    if scene.sky is None:
        return np.broadcast_to(vector(scene.radiance), direction.shape)
    height, width, _ = scene.sky.texels.shape
    x, y, z = direction.T
    column = (np.arctan2(x, -z) / (2 * np.pi) + 0.5) * width - 0.5
    row = np.arccos(np.clip(y, -1, 1)) / np.pi * height - 0.5
    return vector(scene.radiance) * bilinear(scene.sky.texels, column, row, "repeat", "clamp")


def bilinear(values, x, y, wrap_x, wrap_y):
    """Values between the centres of texels, which lie at whole numbers (column, row)."""
    left, top = np.floor(x), np.floor(y)
    a, b = (x - left)[:, None], (y - top)[:, None]
    corner = [[texels(values, left + i, top + j, wrap_x, wrap_y) for i in (0, 1)] for j in (0, 1)]
    return (1 - b) * ((1 - a) * corner[0][0] + a * corner[0][1]) + b * ((1 - a) * corner[1][0] + a * corner[1][1])


def texels(values, column, row, wrap_x, wrap_y):
    height, width, _ = values.shape
    found = np.ones(len(column), bool)
    indices = []
    for index, size, wrap in ((row, height, wrap_y), (column, width, wrap_x)):
        index = index.astype(int)
        if wrap == "black":
            found &= (index >= 0) & (index < size)
        indices.append(index % size if wrap == "repeat" else np.clip(index, 0, size - 1))
    return np.where(found[:, None], values[indices[0], indices[1]].astype(float), 0)


def vector(numbers):
    return np.array(numbers, float)


def dot(a, b):
    return (a * b).sum(axis=-1)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
