"""A page on this machine with pictures, derivatives and rays of a scene whose numbers move."""

import dataclasses
import io
import json
import math
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlsplit

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
from ..tracer.ray_tree import trace_tree
from ..tracer.rendering import picture_derivatives, render
from ..tracer.settings import ResolvedSettings
from ..util.digits import format_number
from ..util.text import parse_number
from .derivatives import scale_limit
from .panels import SIGNED, as_pixels, data_address, page_template, png_bytes, signed_pixels
from .rays import draw_tree

HOST = "127.0.0.1"


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
    edges: EdgeMode = "aware"  # Whether derivatives see edges move, as those of `grad` do.
    compiled: set[str] = dataclasses.field(default_factory=set)
    """What was made before, of "picture", "derivative" and "rays"; anything else is compiled first."""

    @property
    def names(self) -> list[str]:
        """The names of the numbers that move."""
        return [slider.name for slider in self.sliders]

    def values(self, scene: Scene) -> dict[str, str]:
        """The numbers of a scene that move, written so that reading them gives the same bits."""
        return {name: format_number(np.asarray(get_parameter(scene, name)).flat[0]) for name in self.names}

    def picture(self, scene: Scene) -> bytes:
        image = np.asarray(render(scene, self.settings).image)
        self.compiled.add("picture")
        return png_bytes(Image.fromarray(as_pixels(image, self.transfer)))

    def derivative(self, scene: Scene, name: str) -> tuple[bytes, dict[str, Any]]:
        """The derivative by a number as PNG, the mean of R, G and B, and the scale of its colours as `scale_of`."""
        settings = dataclasses.replace(self.settings, edges=self.edges)
        derivatives = picture_derivatives(scene, self.names, settings)  # By all names: then one program is compiled.
        self.compiled.add("derivative")
        values = derivatives.values[derivatives.names.index(name)]
        mean = np.nan_to_num(np.asarray(values.mean(axis=0), np.float64))
        scale: dict[str, Any] = scale_of(mean) | {"unit": resolve(scene, name).attribute.unit}
        return png_bytes(Image.fromarray(signed_pixels(mean, float(scale["limit"])))), scale

    def rays(self, scene: Scene, column: int, row: int) -> bytes:
        """The rays of a pixel of the whole picture as SVG."""
        settings = dataclasses.replace(self.settings, edges="point", samples=1)
        tree = trace_tree(scene, (column, row), settings)
        file, figure = io.BytesIO(), draw_tree(tree, scene, f"pixel {column} {row}", settings)
        figure.savefig(file, format="svg", bbox_inches="tight")
        self.compiled.add("rays")
        return file.getvalue()


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
    """A server of the studio's page, on this machine only, that answers one request at a time.

    `serve_forever` runs it, in the thread that set JAX up. Port 0 takes any that is free; `server_port` says which.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                body, media, code = answer(studio, title, self.path)
            except Exception as error:
                code = 400 if isinstance(error, RaytraceError) else 500
                if code == 500:
                    self.server.handle_error(self.request, self.client_address)  # Writes where it happened.
                body, media = one_sentence(error).encode(), "text/plain; charset=utf-8"
            self.send_response(code)
            self.send_header("Content-Type", media)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing: requests are not told."""

    try:
        return HTTPServer((HOST, port), Handler)
    except OSError as cause:
        raise RaytraceError(f"port {port} of {HOST} cannot be had: {cause.strerror}.") from None


def answer(studio: Studio, title: str, path: str) -> tuple[bytes, str, int]:
    """The body, the media type and the code of the answer to a request.

    An image comes in JSON, with the values it was made with, and what needs no compiling from now on; with a derivative
    the scale of its colours. Raises RaytraceError of a value that cannot be.
    """
    parts = urlsplit(path)
    query = dict(parse_qsl(parts.query))
    if parts.path == "/":
        return render_page(studio, title).encode(), "text/html; charset=utf-8", 200
    if parts.path not in ("/picture", "/derivative", "/rays"):
        return b"there is no such page", "text/plain", 404
    scene = set_parameters(studio.scene, {name: _number(query, name) for name in studio.names if name in query})
    reply: dict[str, object] = {"values": studio.values(scene)}
    media = "image/png"
    if parts.path == "/picture":
        image = studio.picture(scene)
    elif parts.path == "/derivative":
        name = query.get("by", "")
        if name not in studio.names:
            raise ParameterError(f"by is {name!r}; there are {', '.join(studio.names)}.")
        image, reply["scale"] = studio.derivative(scene, name)
    else:
        image, media = studio.rays(scene, *(int(_number(query, key)) for key in ("column", "row"))), "image/svg+xml"
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
        {"name": slider.name, "value": values[slider.name]}
        | {key: format_number(np.float64(getattr(slider, key))) for key in ("start", "stop", "step")}
        for slider in studio.sliders
    ]
    return page_template("report/live.html.jinja").render(
        title=title,
        sliders=sliders,
        window=studio.settings.window(studio.scene.camera.pixeldim),
        edges=studio.edges,
        compiled=sorted(studio.compiled),
        colours=[matplotlib.colors.to_hex(colour) for colour in SIGNED(np.linspace(0, 1, 33))],
    )
