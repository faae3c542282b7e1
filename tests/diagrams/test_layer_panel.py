import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from naraha.diagrams.layer_panel import Key, Layer, add_layer_panel, survey_layers
from naraha.diagrams.recording import ESTIMATE, RecordingConfig, start_meshcat, write_recording
from naraha.systems.display import DOSE_RATE, NIR, POINT_LAYERS, drake_cloud
from naraha.systems.errors import InputError
from naraha.systems.hazards.classes import CLASSES
from pydrake.geometry import Meshcat

PAGE = "<html><body><script>var viewer = new MeshCat.Viewer(pane); // </body>\n</script></body></html>"


class Panel(HTMLParser):
    """Inputs, labels' texts, and the nesting of what was added to a page."""

    def __init__(self, text):
        super().__init__()
        self.inputs, self.open, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag == "input":
            self.inputs.append(dict(attrs))
        else:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def added(layers, page=PAGE):
    """What the panel adds to the page; the rest must be as it was."""
    html = add_layer_panel(page, layers)
    end = page.rfind("</body>")
    assert html.startswith(page[:end])
    assert html.endswith(page[end:])
    return html[end : len(html) - (len(page) - end)]


def base(name="height", shown=True, **options):
    return Layer(name=name, title=name, path=f"layers/{name}", base=True, shown=shown, **options)


def test_every_layer_has_a_switch_for_its_own_path_in_well_formed_markup():
    layers = survey_layers(dose=DOSE_RATE, trajectories={"estimate": ESTIMATE})
    panel = Panel(added(layers))
    assert panel.open == []
    assert [(i["value"], i["data-path"]) for i in panel.inputs] == [(layer.name, layer.path) for layer in layers]
    assert [i["type"] for i in panel.inputs] == ["radio" if layer.base else "checkbox" for layer in layers]
    assert [i["value"] for i in panel.inputs if "checked" in i] == [layer.name for layer in layers if layer.shown]


def test_the_survey_shows_every_growing_layer_and_dose_only_when_there_is_one():
    bases = [layer.name for layer in survey_layers() if layer.base]
    assert bases == [*POINT_LAYERS, "classes"]
    assert [layer.name for layer in survey_layers(dose=DOSE_RATE) if layer.base] == [*bases, "dose"]


def test_the_legend_has_classes_units_ticks_and_the_colours_of_the_points():
    text = added(survey_layers(dose=DOSE_RATE))
    for one in CLASSES:
        assert "#{:02x}{:02x}{:02x}".format(*one.colour) in text
        assert one.title in text
    for words in ("temperature [°C]", "dose rate [µSv/h]", "reflectance at 1450 nm", ">80</span>", ">0.1</span>"):
        assert words in text
    assert ",".join(NIR.stops()) in text


def test_only_the_legend_of_the_shown_layer_is_seen_at_first():
    text = added([base("a", shown=False, legend=NIR), base("b", legend=(Key("b", "#010203"),))])
    assert re.findall(r'data-layer="(\w)"( hidden)?', text) == [("a", " hidden"), ("b", "")]


def test_nothing_is_fetched():
    assert not re.search(r"https?:|//\w+\.|@import|url\(|src=|href=", added(survey_layers(dose=DOSE_RATE)))


def test_titles_are_text_and_never_markup():
    layer = Layer(name="x", title="<b>5 & 6</b>", path='a"b', legend=(Key("<i>", "#000000"), Key("k", "#ffffff")))
    panel = Panel(added([layer]))
    assert "<b>5 & 6</b>" in panel.text
    assert "<i>" in panel.text
    assert panel.inputs[0]["data-path"] == 'a"b'


@pytest.mark.parametrize("page", ["", "<html><body></body></html>", "new MeshCat.Viewer("])
def test_a_page_that_is_not_meshcats_is_refused(page):
    with pytest.raises(InputError, match="not a page of Meshcat"):
        add_layer_panel(page, [base()])


def test_a_page_gets_one_panel_only():
    with pytest.raises(InputError, match="already"):
        add_layer_panel(add_layer_panel(PAGE, [base()]), [base()])


@pytest.mark.parametrize(
    "layers",
    [
        [base(), base("nir")],
        [base(shown=False)],
        [base(), Layer(name="height", title="again", path="a")],
        [Layer(name="", title="x", path="x")],
        [Layer(name='x"y', title="x", path="x")],
        [Layer(name="x", title="x", path="/")],
    ],
)
def test_layers_that_cannot_be_switched_are_refused(layers):
    with pytest.raises(InputError, match=r"layer|name"):
        add_layer_panel(PAGE, layers)


def test_a_recording_has_a_panel_when_it_has_layers(tmp_path):
    meshcat = start_meshcat(RecordingConfig(), live=False)
    meshcat.SetObject("layers/height/00000", drake_cloud(np.zeros((1, 3)), np.zeros((3, 1), np.uint8)))
    write_recording(meshcat, tmp_path / "plain.html")
    write_recording(meshcat, tmp_path / "panel.html", survey_layers())
    plain, panel = ((tmp_path / name).read_text(encoding="utf-8") for name in ("plain.html", "panel.html"))
    assert 'id="layer-panel"' not in plain
    assert panel.count('id="layer-panel"') == 1
    assert panel.count("data:application/octet-binary") == plain.count("data:application/octet-binary")


def test_the_page_of_this_meshcat_has_what_the_panel_calls():
    meshcat = Meshcat()
    meshcat.SetProperty("layers/nir", "visible", False)
    html = meshcat.StaticHtml()
    calls = ["handle_command(", "set_property(", "set_dirty(", "display_progress(", "seek(", "pause("]
    for name in ("var viewer = new MeshCat.Viewer(", "viewer.handle_command_bytearray(", *calls):
        assert name in html


# What the panel needs of a browser and of Meshcat, just enough for its script to run in Node.
STAGE = """
const log = [];
const listeners = {};
const makeInput = (type, value, path, checked) => ({type, value, dataset: {path}, checked,
  parentElement: {classList: {remove: () => log.push(["has data", value])}}});
const inputs = [makeInput("radio", "height", "layers/height", true), makeInput("radio", "nir", "layers/nir", false),
  makeInput("checkbox", "scan", "scan", true)];
const legends = [{dataset: {layer: "height"}}, {dataset: {layer: "nir"}}];
const panel = {querySelectorAll: (what) => what === "input" ? inputs : legends,
  querySelector: () => ({addEventListener: (kind, call) => { listeners.button = call; }, open: true}),
  addEventListener: (kind, call) => { listeners[kind] = call; }};
globalThis.document = {getElementById: () => panel};
globalThis.window = {innerWidth: 1400, addEventListener: (kind, call) => { listeners[kind] = call; }};
globalThis.location = {hash: process.argv[2] || ""};
globalThis.history = {replaceState: (a, b, hash) => { log.push(["link", hash]); }};
const points = {isPoints: true, material: {}};
const visible = {};
globalThis.viewer = {set_property: (path, name, value) => { visible[path.join("/")] = value; }, set_dirty: () => {},
  handle_command: (command) => { if (command.type === "set_property") visible[command.path.slice(1)] = command.value; },
  scene_tree: {find: () => ({object: {traverse: (call) => call(points)}})},
  animator: {actions: [1], duration: 9, pause: () => log.push(["pause"]), seek: (t) => log.push(["seek", t]),
    display_progress: () => {}}};
"""


@pytest.fixture
def play(tmp_path):
    """`play(steps, hash)` runs the script with steps of JavaScript after it; returns what is visible, and the log."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no Node.js to run the panel's script")

    def run(steps="", link=""):
        script = re.search(r"<script>(.*)</script>", added([base()]), re.DOTALL).group(1)
        file = tmp_path / "panel.js"
        result = "console.log(JSON.stringify([visible, log, points.material, legends.map((one) => one.hidden)]));"
        file.write_text(f"{STAGE}\n{script}\n{steps}\n{result}")
        return json.loads(subprocess.run([node, file, link], capture_output=True, text=True, check=True).stdout)

    return run


def test_the_script_shows_the_first_layers_and_follows_the_switches(play):
    visible, _, _, hidden = play()
    assert visible == {"drake/layers/height": True, "drake/layers/nir": False, "drake/scan": True}
    assert hidden == [False, True]
    switched = "inputs[0].checked = false; inputs[1].checked = true; inputs[2].checked = false; listeners.change();"
    visible, log, _, hidden = play(switched)
    assert visible == {"drake/layers/height": False, "drake/layers/nir": True, "drake/scan": False}
    assert hidden == [True, False]
    assert log == [["link", "#layer=nir&hide=scan"]]


def test_the_script_obeys_a_link_even_when_the_page_sets_the_layer_later(play):
    late = (
        'viewer.handle_command({type: "set_property", path: "/drake/layers/nir", property: "visible", value: false});'
    )
    visible, _, _, _ = play(late, "#layer=nir&hide=scan")
    assert visible == {"drake/layers/height": False, "drake/layers/nir": True, "drake/scan": False}
    visible, _, _, _ = play("", "#layer=lava&show=lava")
    assert visible == {"drake/layers/height": True, "drake/layers/nir": False, "drake/scan": True}


def test_the_script_stops_the_replay_where_the_link_says(play):
    loaded = 'viewer.handle_command({type: "set_animation", animations: []});'
    assert play(loaded, "#time=end")[1][-2:] == [["pause"], ["seek", 9]]
    assert play(loaded, "#time=4.5")[1][-1] == ["seek", 4.5]
    assert play(loaded, "#time=soon")[1] == play(loaded)[1] == []
    assert play("listeners.button();")[1] == [["pause"], ["seek", 9]]


def test_the_script_notes_which_layers_have_data_and_gives_points_the_colours_of_the_legend(play):
    _, log, material, _ = play('viewer.handle_command({type: "set_object", path: "/drake/layers/nir/00003"});')
    assert log == [["has data", "nir"]]
    assert material["toneMapped"] is False
