"""A panel in a Meshcat recording that switches layers and says what their colours mean.

The panel is plain HTML, CSS and JavaScript inside the page; nothing is fetched. It sets the visibility of each layer's
own path. The recording animates the visibility of objects below that path, so the two do not meet: an object is seen
when its layer is on and its time has come.

A link can choose what is seen: `recording.html#layer=nir&show=sources&hide=station&time=end`. `layer` names the
colours of the map, `show` and `hide` list other layers, `time` is in seconds or `end`, where the replay then stops.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from naraha.systems.display import POINT_LAYERS, ColourScale, layer_path
from naraha.systems.errors import InputError
from naraha.systems.hazards.classes import CLASSES, HEAT, SOURCE, WATER, SemanticClass
from pydrake.geometry import Rgba

from .layer_panel_page import SCRIPT, STYLE


@dataclass(frozen=True)
class Key:
    """One line of a legend: what has the colour "#rrggbb"."""

    title: str
    colour: str


@dataclass(frozen=True, kw_only=True)
class Layer:
    """Something in the scene that can be switched.

    Attributes:
        name: short, in links: lower-case letters, digits, "_" and "-".
        title: as people read it.
        path: in Meshcat, below `/drake`.
        base: of all layers with `base` exactly one is seen at a time.
        shown: whether it is seen at first.
        legend: what its colours mean.
    """

    name: str
    title: str
    path: str
    base: bool = False
    shown: bool = False
    legend: ColourScale | tuple[Key, ...] = ()


def survey_layers(*, dose: ColourScale | None = None, trajectories: Mapping[str, Rgba] | None = None) -> list[Layer]:
    """The layers of a survey as `naraha.systems.display` draws them.

    Args:
        dose: scale that `draw_dose` gave; without it there is no layer `dose`.
        trajectories: colours of the drawn trajectories by name.
    """
    titles = {"height": "height", "intensity": "LiDAR intensity", "nir": "near infrared", "temperature": "temperature"}
    layers = [
        Layer(name=name, title=titles[name], path=layer_path(name), base=True, shown=name == "height", legend=scale)
        for name, scale in POINT_LAYERS.items()
    ]
    classes = tuple(_class_key(one) for one in CLASSES)
    layers.append(Layer(name="classes", title="class", path=layer_path("classes"), base=True, legend=classes))
    if dose is not None:
        layers.append(Layer(name="dose", title="dose rate", path=layer_path("dose"), base=True, legend=dose))
    paths = tuple(Key(name, _hex_of(rgba)) for name, rgba in (trajectories or {}).items())
    return [
        *layers,
        Layer(name="water", title="puddles", path="regions/water", shown=True, legend=(_class_key(WATER),)),
        Layer(name="heat", title="hot regions", path="regions/heat", shown=True, legend=(_class_key(HEAT),)),
        Layer(name="sources", title="sources, 2σ", path="sources", shown=True, legend=(_class_key(SOURCE),)),
        Layer(name="trajectory", title="trajectories", path="trajectory", shown=True, legend=paths),
        Layer(name="scan", title="newest scan", path="scan", shown=True, legend=(Key("newest scan", "#ffffff"),)),
        Layer(name="station", title="robot and world", path="station", shown=True),
    ]


def add_layer_panel(html: str, layers: Sequence[Layer]) -> str:
    """Returns Meshcat's static page with the panel; the rest of the page is unchanged.

    Raises:
        InputError: this is not a page of Meshcat or has a panel already, or the layers are not usable.
    """
    _check(layers)
    end = html.rfind("</body>")
    if end < 0 or "new MeshCat.Viewer(" not in html:
        raise InputError("not a page of Meshcat", key="html", valid="what Meshcat.StaticHtml() returns")
    if 'id="layer-panel"' in html:
        raise InputError("the page has a panel already", key="html")
    return html[:end] + _panel(layers) + html[end:]


def _check(layers: Sequence[Layer]) -> None:
    names = [layer.name for layer in layers]
    for layer in layers:
        if names.count(layer.name) > 1:
            raise InputError("two layers have one name", key="layers", value=layer.name)
        if not layer.name or not set(layer.name) <= set("abcdefghijklmnopqrstuvwxyz0123456789_-"):
            raise InputError("not a name", key="layers", value=layer.name, valid="a-z, 0-9, _ and -")
        if not layer.path.strip("/"):
            raise InputError("a layer needs a path", key=layer.name, value=layer.path)
    if any(layer.base for layer in layers) and sum(layer.base and layer.shown for layer in layers) != 1:
        raise InputError("exactly one base layer is shown at first", key="layers")


def _panel(layers: Sequence[Layer]) -> str:
    base = [layer for layer in layers if layer.base]
    others = [layer for layer in layers if not layer.base]
    parts = [f'<style>{STYLE}</style>\n<aside id="layer-panel" aria-label="Layers">\n<details open>']
    parts.append("<summary>Layers</summary>")
    if base:
        parts.append("<fieldset><legend>Colour of the map</legend>")
        parts += [_switch(layer, "radio") for layer in base]
        parts.append("</fieldset>")
        parts += [_legend(layer) for layer in base]
    if others:
        parts.append("<fieldset><legend>Also show</legend>")
        parts += [_switch(layer, "checkbox") for layer in others]
        parts.append("</fieldset>")
    parts.append('<button type="button">Jump to the end</button>\n</details>\n</aside>')
    parts.append(f"<script>{SCRIPT}</script>\n")
    return "\n".join(parts)


def _switch(layer: Layer, kind: str) -> str:
    checked = " checked" if layer.shown else ""
    path = escape(layer.path.strip("/"))
    switch = f'<input type="{kind}" name="{kind}" value="{layer.name}" data-path="{path}"{checked}>'
    keys: tuple[Key, ...] = () if layer.base or isinstance(layer.legend, ColourScale) else layer.legend
    if len(keys) == 1:  # what is switched is all that has the colour
        return f'<label class="empty">{switch}{escape(layer.title)}{_swatch(keys[0])}</label>'
    lines = "".join(f'<div class="key below">{_swatch(key)}{escape(key.title)}</div>' for key in keys)
    return f'<label class="empty">{switch}{escape(layer.title)}</label>{lines}'


def _legend(layer: Layer) -> str:
    hidden = "" if layer.shown else " hidden"
    if isinstance(layer.legend, ColourScale):
        body = _colour_bar(layer.legend)
    else:
        body = "".join(f'<div class="key">{_swatch(key)}{escape(key.title)}</div>' for key in layer.legend)
    return f'<div class="legend" data-layer="{layer.name}"{hidden}>{body}</div>'


def _colour_bar(scale: ColourScale) -> str:
    title = f"{scale.title} [{scale.unit}]" if scale.unit else scale.title
    ticks = "".join(f'<span style="left:{100 * at:.1f}%">{escape(text)}</span>' for at, text in scale.ticks(5))
    colours = ",".join(scale.stops())
    return (
        f'<div>{escape(title)}</div><div class="bar" style="background:linear-gradient(to right,{colours})"></div>'
        f'<div class="ticks">{ticks}</div>'
    )


def _swatch(key: Key) -> str:
    return f'<i class="swatch" style="background:{escape(key.colour)}"></i>'


def _class_key(one: SemanticClass) -> Key:
    return Key(one.title, "#{:02x}{:02x}{:02x}".format(*one.colour))


def _hex_of(rgba: Rgba) -> str:
    return "#{:02x}{:02x}{:02x}".format(*(round(255 * channel) for channel in (rgba.r(), rgba.g(), rgba.b())))


__all__: Sequence[str] = ["Key", "Layer", "add_layer_panel", "survey_layers"]
