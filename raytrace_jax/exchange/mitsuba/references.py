"""References between Mitsuba's plugins, replaced by what they refer to."""

import re
from collections.abc import Iterable, Mapping

from raytrace_jax.errors import SceneError
from raytrace_jax.exchange.mitsuba.plugins import Plugin, Ref, Value, numbered

NAMELESS = re.compile(r"ref( \d+)?")
"""The key of a reference that has no name."""

ROLES = {"bsdf", "emitter", "film", "sampler", "rfilter", "phase"}
"""Plugins whose role in another one is their tag, whatever name they are given."""


def resolved(plugins: Iterable[Plugin | Ref], path: str) -> list[Plugin]:
    """Replace references by what they refer to.

    Raises:
        SceneError: there is no plugin of that name.
    """
    # A name may be defined anywhere, also within another plugin.
    plugins = list(plugins)
    named: dict[str, Plugin] = {}

    def collect(plugin: Plugin) -> None:
        if plugin.name:
            named[plugin.name] = plugin
        for value in plugin.values.values():
            if isinstance(value, Plugin):
                collect(value)

    for plugin in plugins:
        if isinstance(plugin, Plugin):
            collect(plugin)

    # Each name is looked up once: references to references would double with every step.
    done: dict[str, Value] = {}

    def look_up(value: Value, within: tuple[str, ...] = ()) -> Value:
        if isinstance(value, Ref):
            if value.name not in named or value.name in within:
                raise SceneError(f"{path}: ref {value.name}: there is no such plugin.")
            if value.name not in done:
                done[value.name] = look_up(named[value.name], (*within, value.name))
            return done[value.name]
        return value._replace(values=_mapped(value.values, within)) if isinstance(value, Plugin) else value

    def _mapped(values: Mapping[str, Value], within: tuple[str, ...]) -> dict[str, Value]:
        found: dict[str, Value] = {}
        for key, value in values.items():
            entry = look_up(value, within)
            place = key
            # A material that is referred to without a role has that of its tag.
            is_nameless = isinstance(value, Ref) and NAMELESS.fullmatch(key)
            if isinstance(entry, Plugin) and (is_nameless or entry.tag in ROLES):
                place = next(name for name in numbered(entry.tag) if name not in found)
            found[place] = entry
        return found

    return [entry for plugin in plugins if isinstance(entry := look_up(plugin), Plugin)]
