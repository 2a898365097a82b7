"""A page on this machine with pictures, derivatives and rays of a scene whose numbers move."""

import base64
import contextlib
import dataclasses
import gzip
import io
import itertools
import json
import math
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, HTTPServer, ThreadingHTTPServer
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, quote, urlencode, urlsplit

import matplotlib
import matplotlib.colors
import matplotlib.ticker
import numpy as np
from jaxtyping import Float
from PIL import Image

from ..errors import ParameterError, RaytraceError, one_sentence
from ..images import Transfer
from ..scene.parameters import get_parameter, resolve, set_parameters
from ..scene.scene import Scene
from ..scene.setting_words import EdgeMode
from ..tracer.ray_tree import RayNode, trace_tree
from ..tracer.rendering import picture_derivatives, render
from ..tracer.settings import ResolvedSettings
from ..util.background import with_settings
from ..util.digits import format_number
from ..util.text import parse_number
from .derivatives import scale_limit
from .panels import SIGNED, as_pixels, data_address, page_template, png_bytes, signed_pixels
from .rays import draw_tree, least_drawn, transparent_shapes

HOST = "127.0.0.1"

QUICK = "picture", "rays"
SLOW = "areas", "derivative"
"""What the page shows. The slow ones are made beside the quick ones, and end when nobody waits for them any more."""


class Slider(NamedTuple):
    """A number that moves, from `start` to `stop`."""

    name: str
    start: float
    stop: float

    @property
    def decimals(self) -> int:
        """The digits after the point of a step: 0.001, or a finer power of ten where that is needed for 1000 steps."""
        return max(3, -math.floor(math.log10((self.stop - self.start) / 1000)))

    @property
    def step(self) -> float:
        return float(f"1e-{self.decimals}")

    def widened(self) -> "Slider":
        """The slider whose ends lie on whole steps, so that all its numbers are short."""
        ten = 10.0**self.decimals
        return self._replace(start=math.floor(self.start * ten) / ten, stop=math.ceil(self.stop * ten) / ten)


@dataclasses.dataclass
class Studio:
    """Pictures, derivatives and rays of one scene, whose structure stays as it is."""

    scene: Scene
    settings: ResolvedSettings
    sliders: tuple[Slider, ...]
    transfer: Transfer
    edges: EdgeMode = "aware"  # Whether there are pictures of areas, and derivatives see edges move as those of `grad`.
    compiled: set[str] = dataclasses.field(default_factory=set)
    """What was made before, of `QUICK` and `SLOW`; anything else is compiled first."""
    locks: Mapping[str, threading.Lock] = dataclasses.field(
        default_factory=lambda: {kind: lock for kinds in (QUICK, SLOW) for lock in [threading.Lock()] for kind in kinds}
    )
    """Of each kind. One quick image is made at a time, and one slow one."""

    @property
    def names(self) -> list[str]:
        """The names of the numbers that move."""
        return [slider.name for slider in self.sliders]

    def values(self, scene: Scene) -> dict[str, str]:
        """The numbers of a scene that move, written so that reading them gives the same bits."""
        return {name: format_number(np.asarray(get_parameter(scene, name)).flat[0]) for name in self.names}

    def picture(self, scene: Scene, kind: str) -> Image.Image:
        """The `picture` of points, or of `areas`."""
        settings = dataclasses.replace(self.settings, edges="aware" if kind == "areas" else "point")
        image = np.asarray(render(scene, settings).image)
        self.compiled.add(kind)
        return Image.fromarray(as_pixels(image, self.transfer))

    def derivative(
        self, scene: Scene, name: str, check: Callable[[], None] = lambda: None
    ) -> tuple[bytes, dict[str, Any]]:
        """The derivative by a number as PNG, the mean of R, G and B, and the scale of its colours as `scale_of`.

        Args:
            check: called before each strip of the picture; raise in it to abort.
        """
        left, top, width, height = self.settings.window(scene.camera.pixeldim)
        # A camera's response may blur, and needs the whole picture. A strip takes no longer than its share.
        rows = height if scene.film is not None else max(1, 8000 // width)
        strips = []
        for row in range(0, height, rows):
            check()
            crop = left, top + row, width, min(rows, height - row)
            settings = dataclasses.replace(self.settings, edges=self.edges, crop=crop)
            found = picture_derivatives(scene, self.names, settings)  # By all names: then one program is compiled.
            strips.append(np.asarray(found.values[found.names.index(name)].mean(axis=0), np.float64))
        self.compiled.add("derivative")
        mean = np.nan_to_num(np.concatenate(strips))
        scale: dict[str, Any] = scale_of(mean) | {"unit": resolve(scene, name).attribute.unit}
        return png_bytes(Image.fromarray(signed_pixels(mean, float(scale["limit"])))), scale

    def rays(self, scene: Scene, column: int, row: int) -> tuple[bytes, str]:
        """The rays of a pixel of the whole picture as SVG, and what the first one meets in words."""
        settings = dataclasses.replace(self.settings, edges="point", samples=1)
        tree = trace_tree(scene, (column, row), settings)
        file, figure = io.BytesIO(), draw_tree(tree, scene, f"pixel {column} {row}", settings, least_drawn(settings))
        # Letters that the browser draws are written sooner than outlines.
        with matplotlib.rc_context({"svg.fonttype": "none"}):
            figure.savefig(file, format="svg", metadata={"Date": None})
        self.compiled.add("rays")
        return file.getvalue(), hit_in_words(tree.nodes[0])


def hit_in_words(ray: RayNode) -> str:
    """What a ray hits, at which angles, and how much of the light goes where."""
    if ray.shape is None:
        return "hits nothing"
    words = [f"hits {ray.shape}", f"incidence {math.degrees(ray.theta_i):.1f}°"]
    if ray.total:
        words.append("total reflection")
    if ray.theta_t is not None:
        words.append(f"refracted to {math.degrees(ray.theta_t):.1f}°")
    words += [
        f"{100 * part:.1f} % {name}"
        for part, name in ((ray.reflect, "reflected"), (ray.transmit, "transmitted"))
        if part
    ]
    return ", ".join(words)


def scale_of(mean: Float[np.ndarray, "height width"]) -> dict[str, Any]:
    """The colour scale of a derivative: its end, as on the sheets of `grad`, or 1 where all is 0; round ticks.

    `beyond` is the fraction of the pixels that exceed it, of those that depend on the parameter.
    """
    limit = scale_limit(mean[None]) or 1.0
    ticks = matplotlib.ticker.MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(-limit, limit)
    changed = np.abs(mean[mean != 0])
    beyond = float(np.mean(changed > limit)) if changed.size else 0.0
    return {"limit": limit, "ticks": [float(t) + 0.0 for t in ticks if abs(t) <= limit], "beyond": beyond}


def make_server(studio: Studio, title: str, port: int = 0) -> HTTPServer:
    """A server of the studio's page, on this machine only; requests have JAX's settings of the thread that calls this.

    Port 0 takes any that is free; `server_port` says which.
    """
    reply = with_settings(answer)

    class Handler(BaseHTTPRequestHandler):
        def check(self) -> None:
            """Raise RaytraceError if the page waits no longer: then it has closed the connection."""
            self.connection.setblocking(False)
            try:
                if not self.connection.recv(1, socket.MSG_PEEK):
                    raise RaytraceError("the page no longer waits for this.")
            except BlockingIOError:
                pass
            except OSError:
                raise RaytraceError("the page no longer waits for this.") from None
            finally:
                self.connection.setblocking(True)

        def do_GET(self) -> None:
            try:
                body, media, code = reply(studio, title, self.path, self.check)
            except Exception as error:
                code = 400 if isinstance(error, RaytraceError) else 500
                if code == 500:
                    self.server.handle_error(self.request, self.client_address)  # Writes where it happened.
                body, media = one_sentence(error).encode(), "text/plain; charset=utf-8"
            with contextlib.suppress(ConnectionError):  # Who moves a slider no longer waits.
                self.send_response(code)
                self.send_header("Content-Type", media)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: requests are not told."""

    try:
        return ThreadingHTTPServer((HOST, port), Handler)
    except OSError as cause:
        raise RaytraceError(f"port {port} of {HOST} cannot be had: {cause.strerror}.") from None


def answer(studio: Studio, title: str, path: str, check: Callable[[], None] = lambda: None) -> tuple[bytes, str, int]:
    """The body, the media type and the code of the answer to a request.

    An image comes in JSON, with the values it was made with, and what needs no compiling from now on; with a derivative
    the scale of its colours, with rays the first hit in words. Raises RaytraceError of a value that cannot be.

    Args:
        check: called while a slow image is made; raise in it to abort.
    """
    parts = urlsplit(path)
    query = dict(parse_qsl(parts.query))
    if parts.path == "/":
        return render_page(studio, title).encode(), "text/html; charset=utf-8", 200
    if (kind := parts.path.removeprefix("/")) not in studio.locks:
        return b"there is no such page", "text/plain", 404
    scene = set_parameters(studio.scene, {name: _number(query, name) for name in studio.names if name in query})
    reply: dict[str, object] = {"values": studio.values(scene)}
    media = "image/png"
    with studio.locks[kind]:
        if kind in SLOW:
            check()
        if kind == "derivative":
            name = query.get("by", "")
            if name not in studio.names:
                raise ParameterError(f"by is {name!r}; there are {', '.join(studio.names)}.")
            image, reply["scale"] = studio.derivative(scene, name, check)
        elif kind == "rays":
            image, reply["words"] = studio.rays(scene, *(int(_number(query, key)) for key in ("column", "row")))
            media = "image/svg+xml"
        else:
            image = png_bytes(studio.picture(scene, kind))
    reply |= {"image": data_address(image, media), "compiled": sorted(studio.compiled)}
    return json.dumps(reply).encode(), "application/json", 200


def _number(query: Mapping[str, str], key: str) -> float:
    try:
        return parse_number(query.get(key, ""))
    except ValueError:
        raise ParameterError(f"{key} is {query.get(key)!r}, and a number is wanted.") from None


def render_page(studio: Studio, title: str) -> str:
    """The page as HTML that needs nothing but this server."""
    values = studio.values(studio.scene)
    sliders = [
        {"name": slider.name, "value": values[slider.name], "choices": []}
        | {key: format_number(np.float64(getattr(slider, key))) for key in ("start", "stop", "step")}
        for slider in studio.sliders
    ]
    pictures = ["picture", "areas"] if studio.edges == "aware" else ["picture"]
    return _fill(studio, title, sliders, pictures)


def saved_page(studio: Studio, title: str, steps: int) -> str:
    """The page as HTML that needs no server: pictures and rays are in it, for `steps` values of each slider.

    Rays are those of `line_of_pixels`.
    """
    scene_values = studio.values(studio.scene)
    sliders = []
    for slider in studio.sliders:
        value = float(scene_values[slider.name])
        numbers = {float(f"{x:.6g}") for x in np.linspace(slider.start, slider.stop, steps)} | {value}
        # Of the scene's own value and the nearest of the others only the first is needed.
        inner = sorted(numbers - {slider.start, slider.stop, value}, key=lambda x: abs(x - value))
        numbers -= set(inner[:1]) if len(numbers) > steps else set()
        choices = [scene_values[slider.name] if x == value else format_number(np.float64(x)) for x in sorted(numbers)]
        ends = {"start": choices[0], "stop": choices[-1], "value": scene_values[slider.name]}
        sliders.append({"name": slider.name, "choices": choices} | ends)
    kind, pixels = "areas" if studio.edges == "aware" else "picture", line_of_pixels(studio)
    saved: dict[str, object] = {}
    for texts in itertools.product(*(slider["choices"] for slider in sliders)):
        values = dict(zip(studio.names, texts, strict=True))
        scene = set_parameters(studio.scene, {name: float(text) for name, text in values.items()})
        file = io.BytesIO()
        studio.picture(scene, kind).save(file, "WEBP", quality=90)
        saved[f"/{kind}?{urlencode(values)}"] = {"image": data_address(file.getvalue(), "image/webp"), "values": values}
        for column, row in pixels:
            image, words = studio.rays(scene, column, row)
            # As text, which packs better than base64.
            reply = {"image": f"data:image/svg+xml,{quote(image)}", "words": words, "values": values}
            saved[f"/rays?{urlencode(values | {'column': column, 'row': row})}"] = reply
    return _fill(studio, title, sliders, [kind], saved, pixels)


def line_of_pixels(studio: Studio, count: int = 7) -> list[tuple[int, int]]:
    """Pixels (column, row) from the middle of what is seen of the first glass to its right rim.

    On a ball incidence goes from about 0 to 90 degrees there. Without glass they lie in the picture's middle row.
    """
    scene = studio.scene
    left, top, width, height = studio.settings.window(scene.camera.pixeldim)
    settings = dataclasses.replace(studio.settings, edges="point", samples=1, aov=("shape_index",))
    seen = np.asarray(render(scene, settings).aov["shape_index"]).reshape(height, width)
    through = transparent_shapes(scene)
    number = next((k for k, name in enumerate(scene.shape_order) if name in through and np.any(seen == k)), None)
    inside = seen == number if number is not None else np.ones_like(seen, bool)
    row = int(np.argmax(inside.sum(axis=1))) if number is not None else height // 2
    columns = np.flatnonzero(inside[row])
    places = np.unique(np.linspace((columns[0] + columns[-1]) / 2, columns[-1], count).astype(int))
    return [(left + int(column), top + row) for column in places]


def _fill(
    studio: Studio,
    title: str,
    sliders: list[dict[str, Any]],
    pictures: list[str],
    saved: dict[str, object] | None = None,
    pixels: Sequence[tuple[int, int]] = (),
) -> str:
    """The page; `saved` are the server's answers by their addresses, where there is no server."""
    return page_template("report/live.html.jinja").render(
        title=title,
        sliders=sliders,
        pictures=pictures,
        packed=base64.b64encode(gzip.compress(json.dumps(saved).encode(), mtime=0)).decode() if saved else "",
        pixels=pixels,
        window=studio.settings.window(studio.scene.camera.pixeldim),
        edges=studio.edges,
        compiled=sorted(studio.compiled),
        colours=[matplotlib.colors.to_hex(colour) for colour in SIGNED(np.linspace(0, 1, 33))],
    )
