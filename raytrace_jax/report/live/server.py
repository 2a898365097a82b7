"""The server of the page: HTTP on this machine only, one request at a time."""

import importlib.resources
from http.server import BaseHTTPRequestHandler, HTTPServer
from urllib.parse import parse_qsl, urlsplit

import jinja2

from raytrace_jax.errors import ParameterError, RaytraceError, one_sentence
from raytrace_jax.report.live.studio import Studio
from raytrace_jax.util.text import parse_number

HOST = "127.0.0.1"

STEPS = 400
"""Of a slider."""


def make_server(studio: Studio, title: str, port: int = 0) -> HTTPServer:
    """A server of the studio's page; `serve_forever` runs it, in the thread that set JAX up.

    Args:
        studio: makes the pictures.
        title: of the page.
        port: 0 takes any that is free; `server_port` says which.

    Raises:
        RaytraceError: the port cannot be had.
    """
    page = render_page(studio, title).encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                self._send(*answer(studio, page, self.path))
            except RaytraceError as error:
                self._send(one_sentence(error).encode(), "text/plain; charset=utf-8", 400)

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


def answer(studio: Studio, page: bytes, path: str) -> tuple[bytes, str, int]:
    """The body, the media type and the code of the answer to a request.

    Raises:
        RaytraceError: the request has a value that cannot be.
    """
    parts = urlsplit(path)
    query = dict(parse_qsl(parts.query))
    if parts.path == "/":
        return page, "text/html; charset=utf-8", 200
    if parts.path not in ("/picture.png", "/derivative.png", "/rays.svg"):
        return b"there is no such page", "text/plain; charset=utf-8", 404
    names = [slider.name for slider in studio.sliders]
    values = {name: number(query, name) for name in names if name in query}
    if parts.path == "/picture.png":
        return studio.picture(values), "image/png", 200
    if parts.path == "/derivative.png":
        by = query.get("by", "")
        if by not in names:
            raise ParameterError(f"by is {by!r}; there are {', '.join(names)}.")
        return studio.derivative(values, by), "image/png", 200
    column, row = (int(number(query, key)) for key in ("column", "row"))
    return studio.rays(values, column, row), "image/svg+xml", 200


def number(query: dict[str, str], key: str) -> float:
    """A number of a query. Raises ParameterError if there is none."""
    try:
        return parse_number(query.get(key, ""))
    except ValueError:
        raise ParameterError(f"{key} is {query.get(key)!r}, and a number is wanted.") from None


def render_page(studio: Studio, title: str) -> str:
    """The page as HTML that needs nothing but this server."""
    source = importlib.resources.files("raytrace_jax.report.live").joinpath("page.html.jinja").read_text("utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    _, _, width, height = studio.settings.window(studio.scene.camera.pixeldim)
    values = studio.values
    sliders = [s._asdict() | {"step": (s.stop - s.start) / STEPS, "value": values[s.name]} for s in studio.sliders]
    return environment.from_string(source).render(
        title=title, sliders=sliders, width=width, height=height, edges=studio.edges
    )
