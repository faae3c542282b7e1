"""Style and behaviour of the panel that `layer_panel` puts into a recording."""

STYLE = """
#layer-panel { position: fixed; top: 10px; left: 10px; width: 210px; max-height: calc(100vh - 40px); overflow-y: auto;
  box-sizing: border-box; padding: 8px 12px; border: 1px solid #8a94a0; border-radius: 6px; background: #fffffff0;
  color: #1b2430; font: 13px/1.4 system-ui, sans-serif; z-index: 10; }
#layer-panel summary { font-weight: 600; cursor: pointer; }
#layer-panel fieldset { margin: 6px 0 0; padding: 0; border: 0; }
#layer-panel fieldset legend { padding: 0; font-weight: 600; color: #47525f; }
#layer-panel label { display: flex; align-items: center; gap: 7px; padding: 1px 0; cursor: pointer; }
#layer-panel label.empty { color: #6c7681; }
#layer-panel label.empty::after { content: "(no data)"; }
#layer-panel input { margin: 0; accent-color: #1f5fae; }
#layer-panel :focus-visible { outline: 2px solid #1f5fae; outline-offset: 2px; }
#layer-panel .legend { margin: 6px 0; padding: 6px 8px; border-radius: 4px; background: #eef1f4; }
#layer-panel .legend[hidden] { display: none; }
#layer-panel .bar { height: 12px; margin: 4px 6px 2px; border: 1px solid #47525f; }
#layer-panel .ticks { position: relative; height: 17px; margin: 0 6px; }
#layer-panel .ticks span { position: absolute; transform: translateX(-50%); }
#layer-panel .key { display: flex; align-items: center; gap: 7px; }
#layer-panel .key.below { margin-left: 20px; }
#layer-panel .swatch { flex: none; width: 12px; height: 12px; border: 1px solid #47525f; border-radius: 2px; }
#layer-panel button { width: 100%; margin-top: 8px; padding: 3px; font: inherit; cursor: pointer; }
"""

# `viewer` is the global variable of Meshcat's page. Its commands arrive later and in any order.
SCRIPT = """
(() => {
  "use strict";
  const panel = document.getElementById("layer-panel");
  const inputs = [...panel.querySelectorAll("input")];
  const before = new Map(inputs.map((input) => [input, input.checked]));
  const fullPath = (input) => "/drake/" + input.dataset.path;
  let time = null;

  const apply = () => {
    for (const input of inputs) {
      viewer.set_property(fullPath(input).slice(1).split("/"), "visible", input.checked);
    }
    for (const legend of panel.querySelectorAll(".legend")) {
      legend.hidden = !inputs.some((input) => input.checked && input.value === legend.dataset.layer);
    }
    viewer.set_dirty();
  };

  // Points and lines have no light on them: with the exact colours of the legend, not mapped to a film's tones.
  const untone = (root) => root.traverse((object) => {
    if (object.isPoints || object.isLine) {
      object.material.toneMapped = false;
      object.material.needsUpdate = true;
    }
  });

  const seek = () => {
    const animator = viewer.animator;
    if (time === null || animator.actions.length === 0) return;
    const at = time === "end" ? animator.duration : Math.min(Number(time), animator.duration);
    if (!Number.isFinite(at)) return;
    animator.pause();
    animator.seek(at);
    animator.display_progress(at);
  };

  const readLink = () => {
    const link = new URLSearchParams(location.hash.slice(1));
    const list = (key) => (link.get(key) || "").split(",");
    const base = inputs.find((input) => input.type === "radio" && input.value === link.get("layer"));
    for (const input of inputs) {
      input.checked = before.get(input);
      if (input.type === "radio") input.checked = base ? input === base : before.get(input);
      else if (list("show").includes(input.value)) input.checked = true;
      else if (list("hide").includes(input.value)) input.checked = false;
    }
    time = link.get("time");
    apply();
    seek();
  };

  const writeLink = () => {
    const names = (type, checked) => inputs.filter((input) => input.type === type && input.checked === checked
      && input.checked !== before.get(input)).map((input) => input.value).join(",");
    const parts = [["layer", names("radio", true)], ["show", names("checkbox", true)],
      ["hide", names("checkbox", false)], ["time", time]].filter((part) => part[1]);
    try {
      history.replaceState(null, "", "#" + parts.map((part) => part.join("=")).join("&"));
    } catch (error) { /* a page inside another one may not change its address */ }
  };

  const handle = viewer.handle_command.bind(viewer);
  viewer.handle_command = (command) => {
    const kind = command.type;
    const given = command.path;  // the viewer replaces the paths of an animation
    handle(command);
    if (kind === "set_animation") seek();
    if (kind === "set_property" && inputs.some((input) => fullPath(input) === given)) apply();
    if (kind === "set_object") {
      untone(viewer.scene_tree.find(given.slice(1).split("/")).object);
      for (const input of inputs) {
        if ((given + "/").startsWith(fullPath(input) + "/")) input.parentElement.classList.remove("empty");
      }
    }
  };

  panel.addEventListener("change", () => { apply(); writeLink(); });
  panel.addEventListener("keydown", (event) => event.stopPropagation());
  panel.querySelector("button").addEventListener("click", () => { time = "end"; seek(); time = null; });
  window.addEventListener("hashchange", readLink);
  if (window.innerWidth < 700) panel.querySelector("details").open = false;
  readLink();
})();
"""
