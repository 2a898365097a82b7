"""The server of the page: HTTP on this machine only, one request at a time."""

import json
from http.server import BaseHTTPRequestHandler, HTTPServer
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from raytrace_jax.errors import ParameterError, RaytraceError, one_sentence
from raytrace_jax.report.live.studio import Studio, scale_colours
from raytrace_jax.report.templates import data_address, page_template
from raytrace_jax.util.text import format_number, parse_number

HOST = "127.0.0.1"

PATHS = ("/picture", "/derivative", "/rays")


def make_server(studio: Studio, title: str, port: int = 0) -> HTTPServer:
    """A server of the studio's page; `serve_forever` runs it, in the thread that set JAX up.

    Args:
        studio: makes the pictures.
        title: of the page.
        port: 0 takes any that is free; `server_port` says which.

    Raises:
        RaytraceError: the port cannot be had.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                reply = answer(studio, title, self.path)
            except Exception as error:
                if not isinstance(error, RaytraceError):
                    self.server.handle_error(self.request, self.client_address)  # Writes where it happened.
                code = 400 if isinstance(error, RaytraceError) else 500
                reply = one_sentence(error).encode(), "text/plain; charset=utf-8", code
            self._send(*reply)

        def _send(self, body: bytes, kind: str, code: int = 200) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Requests are not told."""

    try:
        return HTTPServer((HOST, port), Handler)
    except OSError as cause:
        raise RaytraceError(f"port {port} of {HOST} cannot be had: {cause.strerror}.") from None


def answer(studio: Studio, title: str, path: str) -> tuple[bytes, str, int]:
    """The body, the media type and the code of the answer to a request.

    What is shown comes as JSON: the image, the values it was made with, and what needs no compiling from now on; with
    a derivative the scale of its colours.

    Raises:
        RaytraceError: the request has a value that cannot be.
    """
    parts = urlsplit(path)
    query = dict(parse_qsl(parts.query))
    if parts.path == "/":
        return render_page(studio, title).encode(), "text/html; charset=utf-8", 200
    if parts.path not in PATHS:
        return b"there is no such page", "text/plain; charset=utf-8", 404
    names = [slider.name for slider in studio.sliders]
    scene = studio.moved({name: number(query, name) for name in names if name in query})
    told: dict[str, object] = {"values": studio.values(scene)}
    if parts.path == "/picture":
        told["image"] = data_address(studio.picture(scene), "image/png")
    elif parts.path == "/derivative":
        by = query.get("by", "")
        if by not in names:
            raise ParameterError(f"by is {by!r}; there are {', '.join(names)}.")
        image, scale = studio.derivative(scene, by)
        told |= {"image": data_address(image, "image/png"), "scale": scale._asdict()}
    else:
        column, row = (int(number(query, key)) for key in ("column", "row"))
        told["image"] = data_address(studio.rays(scene, column, row), "image/svg+xml")
    return json.dumps(told | {"compiled": sorted(studio.compiled)}).encode(), "application/json", 200


def number(query: dict[str, str], key: str) -> float:
    """A number of a query. Raises ParameterError if there is none."""
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
    return page_template("raytrace_jax.report.live", "page.html.jinja").render(
        title=title,
        sliders=sliders,
        window=studio.settings.window(studio.scene.camera.pixeldim),
        edges=studio.edges,
        compiled=sorted(studio.compiled),
        colours=scale_colours(),
    )
