/* Beside the scene: what is shown and in which colours, figures, rejections, certificate. */
"use strict";

const LAYERS = [
  ["forces", "Contact forces", "F", true, "Of a gripper what it bears, without its squeeze; with friction cones, each finger's force"],
  ["cones", "Friction cones", "C", false],
  ["newtons", "Newtons on the arrows", "W", true],
  ["names", "Names of things", "N", true],
  ["frames", "Frames of hands, body", "A", false],
  ["start", "Ghost of the start", "S", false],
  ["goal", "Ghost of the goal", "G", false],
  ["places", "Places of the cup considered", "V", false],
  ["grasps", "Grasps considered", "H", false],
  ["map", "Map of the study", "M", true, "Click a tile to open its plan"],
];
/** Strokes on grey tiles, by outcome of their points. */
const MAP_SIGNS = { not_found: "/ not found", infeasible: "× proven infeasible", refused: "– no such task can be", failed: "! failed" };
/** Layers that are shown at first. */
const FIRST_LAYERS = new Set(LAYERS.filter(([, , , first]) => first).map(([name]) => name));
/** Layers that only plans of suction tools have. */
const SIGNS = ["places", "grasps"];
const KEYS = [
  ["play, pause", "Space"], ["0.2 s back, on", "← →"], ["2 s back, on", "Shift ← →"],
  ["previous, next segment", "[ ]"], ["start, end", "Home End"], ["plan, simulation, execution", "P"], ["slower, faster", "- +"], ["camera", "1 to 5"],
];

class Panel {
  /**
   * @param scene  what draws: layer(name, visible); where there is a service also post(task), isLight() and setLight(on)
   * @param visit  called with a time of the plan that somebody wants to see
   */
  constructor(scene, visit) {
    Object.assign(this, { scene, visit });
    this.visible = Object.fromEntries(LAYERS.map(([name, , , first]) => [name, first]));
    this.tabs = { View: (s) => this.view(s), Segments: (s) => this.segments(s), Regrasp: (s) => this.regrasp.panel(s), Lift: (s) => this.executed(s), Physics: (s) => this.executed(s), Figures: (s) => this.figures(s), Rejected: (s) => this.rejected(s), Checks: (s) => this.checks(s) };
    this.current = "View";
    this.regrasp = new Regrasp(document.getElementById("graph"));
  }

  show(description) {
    this.description = description;
    this.regrasp.show(description);
    document.getElementById("tabs").replaceChildren(...description.tabs.map((name) => {
      const tab = element("button", { textContent: name, onclick: () => this.open(name) });
      tab.setAttribute("role", "tab");
      return tab;
    }));
    this.open(description.tabs.includes(this.current) ? this.current : "View");
  }

  /** Layers that this plan has. */
  get layerRows() {
    return LAYERS.filter(([name]) => name === "map" ? this.study?.outcomes : !SIGNS.includes(name) || this.description?.considered);
  }

  /** Tell of the map of a study that is painted onto the plate, or why it is not; null: of none. */
  tellStudy(study) {
    const painted = Boolean(this.study?.outcomes);
    this.study = study;
    if (this.current !== "View" || !this.description) return;
    // While the study runs only its words change, so that whoever is at a switch stays there.
    const told = document.getElementById("study-told");
    if (told && painted && study?.outcomes) told.replaceWith(this.studyWords());
    else this.open("View");
  }

  /** How far the study is, what its colours mean, and where all of it is told. */
  studied() {
    if (!this.study) return [];
    const all = element("p", { className: "quiet" }, element("a", { href: `study?study=${encodeURIComponent(this.study.study)}`, textContent: "The whole study" }));
    if (!this.study.outcomes) return [heading("Map of the study"), this.studyWords(), all];
    const scale = element("div", { className: "map-scale" });
    scale.setAttribute("aria-hidden", "true");
    const ends = element("div", { className: "map-ends" }, element("span", {}, "0 % kept back"), element("span", {}, "20 % and more"));
    return [heading("Map of the study"), scale, ends, this.studyWords(), all];
  }

  studyWords() {
    return Object.assign(quiet(this.study.refusal ?? mapWords(this.study)), { id: "study-told" });
  }

  open(name) {
    this.current = name;
    for (const tab of document.getElementById("tabs").children)
      tab.setAttribute("aria-selected", String(tab.textContent === name));
    document.getElementById("tab-body").replaceChildren(...(this.description ? this.tabs[name](this.description) : []));
  }

  toggle(layer) {
    this.visible[layer] = !this.visible[layer];
    this.scene.layer(layer, this.visible[layer]);
    const box = document.getElementById(`layer-${layer}`);
    if (box) box.checked = this.visible[layer];
  }

  view(description) {
    const meanings = element("ul", { className: "legend pairs" });
    const entries = Object.values(description.legend.meanings);
    meanings.style.setProperty("--rows", Math.ceil(entries.length / 2));
    for (const { colour, words } of entries) {
      const mark = element("i");
      mark.style.borderColor = colour;
      meanings.append(element("li", {}, mark, words));
    }
    const used = new Set(Object.values(description.sources).flatMap(({ segments }) => segments.map(({ kind }) => kind)));
    const kinds = element("ul", { className: "legend" });
    for (const [kind, { colour, words }] of Object.entries(description.legend.segments)) {
      if (!used.has(kind)) continue;
      const mark = element("i", { className: "box" });
      mark.style.background = colour;
      kinds.append(element("li", {}, mark, words));
    }
    const keys = element("div", { className: "keys" });
    for (const [words, key] of KEYS) keys.append(element("div", {}, words, element("kbd", { textContent: key })));
    return [
      ...this.remedies(description),
      ...this.leastReserve(description),
      ...this.studied(),
      heading("Show"), this.layers(),
      heading("Forces and curves"), meanings, ...(used.size ? [heading("Timeline"), kinds] : []), Object.assign(heading("Keys"), { className: "keys-heading" }), keys,
    ];
  }

  /** Where there is no plan, or physics fails: what to change, each with what came of planning it, and a button that has it planned. */
  remedies({ outcome, remedies, pending }) {
    if (outcome !== "solved" && !remedies && pending) return [heading("What to change"), quiet("Changes are being tried …")];
    if (!remedies) return [];
    const items = remedies.map(({ sentence, figures, task }) => {
      const item = element("li", {}, element("b", { textContent: sentence }), element("small", { textContent: figures }));
      if (task && this.scene.post) item.append(element("button", { className: "action", textContent: "Plan it so", onclick: () => this.scene.post(task) }));
      return item;
    });
    const none = outcome === "solved" ? "No change that was tried mends that." : "No single change that was tried leads to a plan.";
    const fails = "The plan passed its certificate and fails in physics. ";
    const told = items.length ? [element("ul", { className: "remedies" }, ...items)] : [quiet(outcome === "solved" ? fails + none : none)];
    if (outcome === "solved" && items.length) told.unshift(quiet(`${fails}What mends that:`));
    return [heading("What to change"), ...told];
  }

  /** How much of the force limits is kept back where least is, and what would give way; pressed, it goes there. */
  leastReserve({ least_reserve: least }) {
    if (!least) return [];
    const button = element("button", { id: "least-reserve", title: "Go there", onclick: () => this.visit(least.time) },
      element("b", { textContent: `${least.value} at ${least.time.toFixed(1)} s` }), element("span", { textContent: least.asked }),
      element("span", { textContent: least.of }), element("small", { textContent: least.where }));
    return [heading("Smallest reserve"), button, ...(least.torque ? [quiet(least.torque)] : [])];
  }

  layers() {
    const list = element("div", { className: "layers" });
    for (const [name, words, key, , about = ""] of this.layerRows) {
      const scale = name === "forces" ? `, ${this.description.force_scale} mm/N` : "";
      const box = element("input", { type: "checkbox", id: `layer-${name}`, checked: this.visible[name] });
      box.onchange = () => this.toggle(name);
      // Of a pointer, not of a key: the next press of Space is to play.
      box.onclick = (event) => event.detail && box.blur();
      list.append(element("label", { title: about }, box, words + scale, element("kbd", { textContent: key })));
    }
    if (this.scene.setLight) list.append(lightSwitch(this.scene));
    return list;
  }

  /** One row a segment: what happens, for how long, the most that a hand bears, what is kept back; pressed, it goes there. */
  segments({ sources }) {
    const { segments } = sources.plan;
    if (!segments.length) return [quiet("Nothing moves: there is no plan.")];
    const rows = segments.map(({ words, hold, start, end, force, reserve }, index) => {
      const go = element("button", { className: "link", textContent: words, title: `${(end - start).toFixed(2)} s, ${hold}`, onclick: () => this.visit(start) });
      return element("tr", {}, element("td", { textContent: index + 1 }), element("td", {}, go),
        ...[start.toFixed(1), force, reserve].map((value) => element("td", { textContent: value })));
    });
    const columns = ["", "what happens", "s", "N", "%"].map((words) => element(words ? "th" : "td", { textContent: words, scope: "col" }));
    const table = element("table", { className: "figures segments" }, element("thead", {}, element("tr", {}, ...columns)), element("tbody", {}, ...rows));
    return [heading("Segments"), element("div", { className: "scroll", tabIndex: 0 }, table), quiet("s: when it begins. N: the most that a hand bears. %: the least share of all limits that is kept back.")];
  }

  executed({ simulation, pending }) {
    if (!simulation) return [quiet(pending ? "This plan is being simulated …" : "This plan was not simulated.")];
    const verdict = element("p", { className: `verdict ${simulation.good ? "good" : "bad"}` },
      element("b", { textContent: simulation.words }), simulation.sentence);
    const model = element("ul", { className: "model" }, ...simulation.model.map((words) => element("li", { textContent: words })));
    return [verdict, ...tables(simulation.figures), ...comparison(simulation.nodes), heading("What is modelled"), model];
  }

  figures(description) {
    return [...tables(description.figures), ...(description.tabs.includes("Rejected") ? [] : this.rejected(description))];
  }

  rejected(description) {
    if (!description.rejections.length) return [quiet("Nothing was rejected.")];
    const most = description.rejections[0][1];
    const list = element("ul", { className: "rejections" });
    for (const [reason, count] of description.rejections) {
      const split = reason.indexOf(": ");
      const bar = element("div", { className: "bar" });
      bar.style.width = `${(100 * count) / most}%`;
      list.append(element("li", {},
        element("b", { textContent: count.toLocaleString("en") }),
        element("small", { textContent: split > 0 ? reason.slice(0, split) : "" }),
        capitalised(reason.slice(split > 0 ? split + 2 : 0)), bar));
    }
    return [heading("Why candidates fell out"), list];
  }

  checks(description) {
    if (!description.certificate) return [quiet("There is no certificate: nothing was planned that could be checked.")];
    const list = element("ul", { className: "checks" });
    const { title, about, checks } = description.certificate;
    for (const { name, sentence, passed, margin, unit, where } of checks) {
      const verdict = element("span", { className: passed ? "yes" : "no", textContent: passed ? "✓" : "✗" });
      verdict.setAttribute("role", "img");
      verdict.setAttribute("aria-label", passed ? "passed" : "failed");
      list.append(element("li", { title: where }, verdict, capitalised(name), element("small", { textContent: marginWords(margin, unit) }),
        element("p", { textContent: passed ? sentence : `${sentence} ${capitalised(where)}.` })));
    }
    return [heading(title), ...(about ? [quiet(about)] : []), list];
  }
}

/** The switch between drawing lightly and fully. */
function lightSwitch(scene) {
  const box = element("input", { type: "checkbox", id: "light", checked: scene.isLight() });
  box.onchange = () => scene.setLight(box.checked);
  return element("label", { title: "Fewer triangles, no shadows: for machines without a graphics card" }, box, "Light drawing, no shadows");
}

/** What the tiles of a map say. */
function mapWords({ count, outcomes }) {
  const known = Object.values(outcomes).reduce((sum, each) => sum + each, 0);
  const solved = known < count ? `${known} of ${count} cup places are known so far, ${outcomes.solved} of them solved` : `${outcomes.solved} of ${count} cup places are solved`;
  const grey = Object.entries(MAP_SIGNS).filter(([outcome]) => outcomes[outcome]).map(([, words]) => words).join(", ");
  return `${solved}${grey ? `; grey: ${grey}` : ""}. Click a tile to open its plan.`;
}

/** Groups of figures, each a table under its title. */
function tables(groups) {
  return groups.flatMap(({ title, rows }) => [heading(title), table(rows)]);
}

function table(rows) {
  const cells = (row) => row.map((value) => element("td", { textContent: value }));
  return element("table", { className: rows[0]?.length > 2 ? "figures wide" : "figures" }, ...rows.map((row) => element("tr", {}, ...cells(row))));
}

/** Planned and simulated forces at the end of each of the plate's motions. */
function comparison(nodes) {
  if (!nodes.length) return [];
  const rows = nodes.flatMap(({ time, forces }) =>
    forces.map(([by, planned, simulated], index) => [index ? "" : `${time.toFixed(1)} s`, by, planned, simulated]));
  return [heading("Forces, N"), table([["", "", "plan", "sim."], ...rows])];
}

/** A margin with its unit; nothing where a check has none, or compares quantities of several units at once. */
function marginWords(margin, unit) {
  if (margin === null || !unit || unit === "1" || unit.includes(",")) return "";
  const small = ["m", "s"].includes(unit) && Math.abs(margin) < 0.1;
  const value = small ? 1000 * margin : margin;
  const tiny = value !== 0 && Math.abs(value) < 1e-3;
  return `${tiny ? value.toExponential(0) : Number(value.toPrecision(3))} ${small ? "m" : ""}${unit.replace("^2", "²")}`;
}

function capitalised(words) {
  return words.charAt(0).toUpperCase() + words.slice(1);
}

function heading(words) {
  return element("h3", { textContent: words });
}

function quiet(words) {
  return element("p", { className: "quiet", textContent: words });
}
