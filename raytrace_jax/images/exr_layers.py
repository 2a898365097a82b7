"""Channel names as layers: `ViewLayer.Combined.R` is the component `R` of the layer `ViewLayer.Combined`."""

import difflib
from collections.abc import Iterable

from raytrace_jax.errors import PictureError

RGB = ("R", "G", "B")


def group_by_layer(names: Iterable[str]) -> dict[str, set[str]]:
    """Return the components of every layer; channels without a layer, such as `R`, belong to the layer ''."""
    layers: dict[str, set[str]] = {}
    for name in names:
        layer, _, component = name.rpartition(".")
        layers.setdefault(layer, set()).add(component)
    return layers


def find_layer(names: Iterable[str], wanted: str, *, where: str) -> str:
    """Return the full name of the layer `wanted`, which may be only its end: `Combined` for `ViewLayer.Combined`.

    Raises:
        PictureError: no layer, or more than one, goes by that name; `where` starts the message.
    """
    layers = sorted(group_by_layer(names))
    if wanted in layers:
        return wanted
    ends = [layer for layer in layers if layer.endswith(f".{wanted}")]
    if len(ends) == 1:
        return ends[0]
    if ends:
        raise PictureError(f"{where}: the layer {wanted!r} can be any of {_listed(ends)}; give the full name")
    close = difflib.get_close_matches(wanted, layers)
    hint = f"; did you mean {_listed(close)}?" if close else ""
    raise PictureError(f"{where}: has no layer {wanted!r}; its layers are {_listed(layers)}{hint}")


def rgb_channels(names: Iterable[str], layer: str | None, *, where: str) -> tuple[str, str, str]:
    """Return the three channel names that make the picture; a grey layer gives its `Y` three times.

    Without `layer`, the picture is the channels without a layer if they have a colour, else the only layer
    with a colour, else the only one called `Combined`, as Blender has it.

    Raises:
        PictureError: the layer has no colour, or the choice is not obvious; the message lists the layers.
    """
    components = group_by_layer(names)
    if layer is not None:
        chosen = find_layer(names, layer, where=where)
        if not _has_colour(components[chosen]):
            has = ", ".join(sorted(components[chosen]))
            raise PictureError(
                f"{where}: the layer {chosen!r} has the channels {has}, and R, G, B or a grey Y is wanted"
            )
    else:
        chosen = _obvious_layer(components, where)
    red, green, blue = RGB if components[chosen].issuperset(RGB) else ("Y", "Y", "Y")
    prefix = f"{chosen}." if chosen else ""
    return prefix + red, prefix + green, prefix + blue


def _obvious_layer(components: dict[str, set[str]], where: str) -> str:
    candidates = sorted(layer for layer in components if _has_colour(components[layer]))
    if not candidates:
        raise PictureError(
            f"{where}: has no layer with the channels R, G, B or a grey Y; its layers are "
            + "; ".join(f"{layer!r} ({', '.join(sorted(components[layer]))})" for layer in sorted(components))
        )
    if "" in candidates:
        return ""
    combined = [layer for layer in candidates if layer.rpartition(".")[2] == "Combined"]
    for obvious in (candidates, combined):
        if len(obvious) == 1:
            return obvious[0]
    raise PictureError(f"{where}: has several pictures, name one of the layers {_listed(candidates)}")


def _has_colour(components: set[str]) -> bool:
    # A Y beside an X is a vector's second component (`normal.X normal.Y normal.Z`), not a grey picture.
    return components.issuperset(RGB) or ("Y" in components and "X" not in components)


def _listed(layers: list[str]) -> str:
    return ", ".join(repr(layer) for layer in layers)
