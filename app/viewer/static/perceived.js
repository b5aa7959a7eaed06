/* A perceived scene: what is told of it beside its drawing, its layers, and the list of all of them. */
"use strict";

const PERCEIVED_LAYERS = [
  ["points", "Points of the objects", "P"],
  ["around", "All other points", "A"],
  ["models", "Fitted models", "M"],
  ["names", "Names and sizes", "N"],
  ["tool", "The tool as perceived", "T"],
  ["robot", "Robot at home", "R"],
];

class Perceived {
  /** @param scene what draws: layer(name, visible) and look(view) */
  constructor(scene) {
    this.scene = scene;
    this.visible = Object.fromEntries(PERCEIVED_LAYERS.map(([name]) => [name, true]));
    this.list = document.getElementById("scene-list");
    this.scenes = [];
    window.addEventListener("keydown", (event) => this.key(event), true);
  }

  /** Show a scene that was opened. */
  open(description) {
    this.description = description;
    document.body.classList.remove("empty", "still");
    document.body.classList.add("perceived");
    document.title = `${description.title} · Liftwright`;
    Object.assign(document.getElementById("title"), { textContent: description.title, title: description.title });
    document.getElementById("subtitle").textContent = description.subtitle;
    document.getElementById("highlights").replaceChildren(
      ...description.highlights.map(([label, value]) => element("div", {}, element("dt", { textContent: label }), element("dd", { textContent: value }))));
    const base = `../v1/scenes/${description.id}`;
    document.getElementById("links").replaceChildren(
      element("a", { href: `${base}/preview.png`, target: "_blank", textContent: "Picture", title: "What the cameras saw, with everything that was found drawn in" }),
      element("a", { href: base, target: "_blank", textContent: "Document", title: "The scene as tasks name it" }),
    );
    for (const [name, visible] of Object.entries(this.visible)) if (!visible) this.scene.layer(name, false);
    document.getElementById("tab-body").replaceChildren(...this.told(description, base));
    document.getElementById("tab-body").scrollTop = 0;
  }

  /** Show no scene, or one that there is only a name of. */
  close() {
    this.description = null;
    document.body.classList.remove("perceived");
  }

  told({ objects, tool, table, unrecognised, unrecognised_colour, notes }, base) {
    const picture = element("a", { className: "picture", href: `${base}/preview.png`, target: "_blank" },
      element("img", { src: `${base}/preview.png`, alt: "What the cameras saw" }));
    return [
      heading("Show"), this.layers(),
      heading("Objects"), ...(objects.length ? objects.map((each) => found(each.colour, each.name, each.shape, each.rows)) : [quiet("None was found.")]),
      ...(unrecognised.length ? [heading("Not recognised"), ...unrecognised.map(({ reason, place }) => found(unrecognised_colour, capitalised(reason), "", [[place]]))] : []),
      ...(tool ? [heading("Tool"), found("var(--mark)", tool.name, "by its markers", tool.rows)] : []),
      ...(table ? [heading("Table"), element("div", { className: "found" }, facts(table))] : []),
      ...(notes.length ? [heading("Notes"), ...notes.map((words) => quiet(capitalised(words)))] : []),
      heading("Picture"), picture,
      quiet("±: 19 of 20 errors are smaller."),
    ];
  }

  layers() {
    const list = element("div", { className: "layers" });
    for (const [name, words, key] of PERCEIVED_LAYERS) {
      const box = element("input", { type: "checkbox", id: `layer-${name}`, checked: this.visible[name] });
      box.onchange = () => this.toggle(name);
      list.append(element("label", {}, box, words, element("kbd", { textContent: key })));
    }
    list.append(lightSwitch(this.scene));
    return list;
  }

  toggle(layer) {
    this.visible[layer] = !this.visible[layer];
    this.scene.layer(layer, this.visible[layer]);
    document.getElementById(`layer-${layer}`).checked = this.visible[layer];
  }

  /** Keys of a perceived scene; those it takes do not reach the scene's camera. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.description || isTypedInto(event.target)) return;
    const layer = PERCEIVED_LAYERS.find(([, , key]) => key.toLowerCase() === event.key.toLowerCase());
    const view = VIEWS[Number(event.key) - 1];
    if (!layer && !view) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (layer) this.toggle(layer[0]);
    else this.scene.look(view);
  }

  /** List scenes, the newest first. @param choose called with the id of the one that is wanted */
  show(scenes, wanted, choose) {
    this.scenes = scenes;
    const items = scenes.map((scene) => this.item(scene, wanted, choose));
    const fresh = element("ul", {}, ...items);
    document.getElementById("scenes").hidden = !scenes.length;
    if (this.list.innerHTML !== fresh.innerHTML) this.list.replaceChildren(...items);
  }

  item({ id, external_id, objects, unrecognised, created_at }, wanted, choose) {
    const name = external_id ?? id.slice(0, 8);
    const words = `${objects} object${objects === 1 ? "" : "s"}${unrecognised ? `, ${unrecognised} unclear` : ""}`;
    const item = element("li", { className: "scene", tabIndex: 0 }, element("span", { className: "dot" }),
      element("b", { textContent: name, title: name }), element("small", { textContent: `${words} · ${clockTime(created_at)}` }));
    item.dataset.scene = id;
    item.setAttribute("role", "option");
    item.setAttribute("aria-selected", String(id === wanted));
    item.onclick = () => choose(id);
    item.onkeydown = (event) => listKey(event, () => choose(id));
    return item;
  }
}

/** One thing that was found: its colour and name, what it is, and facts about it. */
function found(colour, name, kind, rows) {
  const mark = element("i", { className: "box" });
  mark.style.background = colour;
  return element("div", { className: "found" }, element("h4", {}, mark, name, element("small", { textContent: kind })), facts(rows));
}

function facts(rows) {
  return element("table", { className: "figures" }, ...rows.map((row) => element("tr", {}, ...row.map((value) => element("td", { textContent: value })))));
}

function clockTime(moment) {
  return new Date(moment).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
}

/** Keys of an item in a list: Enter takes it, arrows go to its neighbours; all others do what they always do. */
function listKey(event, take) {
  const { previousElementSibling: above, nextElementSibling: below } = event.currentTarget;
  const skip = (item, way) => (item?.className === "day" ? item[way] : item);
  const neighbour = { ArrowUp: skip(above, "previousElementSibling"), ArrowDown: skip(below, "nextElementSibling") }[event.key];
  if (event.key === "Enter") take();
  else if (neighbour) neighbour.focus();
  else return;
  event.preventDefault();
}
