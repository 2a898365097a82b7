"""Pages of HTML from Jinja's templates, which lie beside the code that fills them, and files within such a page."""

import base64
import importlib.resources
from collections.abc import Callable, Mapping
from typing import Any

import jinja2


def page_template(package: str, name: str, filters: Mapping[str, Callable[..., Any]] | None = None) -> jinja2.Template:
    """The template of this name in a package; text is escaped, and what is undefined is an error.

    Args:
        package: as `raytrace_jax.batch`.
        name: of the template's file there.
        filters: what the template applies to values, by name.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= filters or {}
    return environment.from_string(importlib.resources.files(package).joinpath(name).read_text(encoding="utf-8"))


def data_address(body: bytes, kind: str = "image/png") -> str:
    """A file as an address that holds it, of this media type."""
    return f"data:{kind};base64,{base64.b64encode(body).decode()}"
