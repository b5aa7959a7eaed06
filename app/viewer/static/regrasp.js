/* What a suction-tool planner considered: counts by reason in the panel, and the regrasp graph over the scene. */
"use strict";

const SVG = "http://www.w3.org/2000/svg";
const HANDOVERS = ["handover 0", "handover 1"];
const COLUMN_TITLES = {
  initial: ["Tool at its start", "at rest, or in the hand that has it"],
  "handover 0": ["Handover", "the tool alone"],
  suction: ["Cup on the object", "where the object is"],
  "handover 1": ["Handover", "with the object"],
  goal: ["Object at its goal", ""],
};
const UNASKED = "var(--line)";
/** Distance of columns at which their captions would overlap [px]. */
const NARROW_PITCH = 135;

class Regrasp {
  /** @param box element over the scene that the graph is drawn in */
  constructor(box) {
    this.box = box;
    new ResizeObserver(() => !this.box.hidden && this.draw()).observe(box.parentElement);
  }

  /** Take another plan. */
  show(description) {
    this.description = description;
    this.considered = description.considered;
    this.colours = Object.fromEntries((description.considered?.colours ?? []).map(({ reason, colour }) => [reason, colour]));
    for (const arm of ["left", "right"]) this.colours[arm] = description.legend.meanings[arm].colour;
    this.name = description.considered?.objects[0]?.name;
    this.box.hidden = true;
  }

  /** Show the object that is moved now. */
  follow(state) {
    const object = this.considered?.objects.find(({ name }) => plain(name) === state);
    if (object && object.name !== this.name) this.choose(object.name);
  }

  choose(name) {
    this.name = name;
    if (this.tab?.isConnected) this.tab.replaceChildren(...this.contents());
    if (!this.box.hidden) this.draw();
  }

  /** Show or hide the graph. */
  toggle(on = this.box.hidden) {
    this.box.hidden = !on || !this.considered;
    if (!this.box.hidden) this.draw();
  }

  get object() {
    return this.considered.objects.find(({ name }) => name === this.name);
  }

  /** The panel's page. */
  panel() {
    if (!this.considered) return [quiet("Nothing was considered.")];
    this.tab = element("div", { id: "considered" }, ...this.contents());
    return [this.tab];
  }

  contents() {
    const { object } = this;
    const open = element("button", { className: "wide", onclick: () => this.toggle() }, "Regrasp graph", element("kbd", { textContent: "R" }));
    return [
      this.chooser(),
      ...(object.graph ? [open, heading("Sequence"), this.sequence(object.graph)] : []),
      heading("Places of the cup on it"), this.tally(object.places, "good"),
      heading("Grasps with the cup on it"), this.tally(object.grasps, "possible"),
    ];
  }

  chooser() {
    const buttons = this.considered.objects.map(({ name }) => {
      const button = element("button", { textContent: plain(name), onclick: () => this.choose(name) });
      button.setAttribute("aria-pressed", String(name === this.name));
      return button;
    });
    return element("div", { className: "chooser" }, ...buttons);
  }

  tally(rows, good) {
    if (!rows.length) return quiet("None were asked.");
    const list = element("ul", { className: "tally" });
    for (const [reason, count] of rows) {
      const mark = element("i", { className: "box" });
      mark.style.background = this.colours[reason];
      list.append(element("li", {}, mark, element("span", { textContent: reason ?? good }), element("b", { textContent: count.toLocaleString("en") })));
    }
    return list;
  }

  /** The chosen edges in words. */
  sequence(graph) {
    if (!graph.sequence.length) return quiet("No sequence was found.");
    const steps = graph.sequence.map((number) => element("li", { textContent: this.edgeWords(graph, graph.edges[number]) }));
    return element("ol", { className: "steps" }, ...steps);
  }

  edgeWords(graph, { kind, round, from, to }) {
    const arm = (node) => graph.arms[Math.floor(node / this.considered.grasps)];
    const grasp = to % this.considered.grasps;
    if (kind === "pick") return `${arm(to)} hand ${this.object.held ? "has" : "takes"} the tool, grasp ${grasp}`;
    if (kind === "handover") return `${arm(from)} to ${arm(to)} hand, grasp ${grasp}`;
    return round ? `${arm(to)} hand carries the object to its goal` : `${arm(to)} hand puts the cup on the object`;
  }

  // The graph.

  draw() {
    const { graph, name } = this.object;
    const close = element("button", { className: "close", textContent: "×", title: "Close  Esc", onclick: () => this.toggle(false) });
    close.setAttribute("aria-label", "Close the regrasp graph");
    const title = element("h3", {}, `Regrasp graph of ${plain(name)}`);
    if (!graph) return this.box.replaceChildren(title, close, this.chooser(), quiet("There is none: nothing was asked for this object."));
    const pairs = graph.handover_pairs.map((count) => count.toLocaleString("en"));
    const words = element("p", {}, `A dot is one of ${this.considered.grasps} grasps of the tool, at the same place in every column. `
      + `${pairs[0]} pairs of grasps can pass the tool on alone, ${pairs[1]} with the object.`);
    const picture = document.createElementNS(SVG, "svg");
    this.box.replaceChildren(title, close, this.chooser(), words, picture, this.key(graph));
    this.picture(picture, graph);
  }

  picture(svg, graph) {
    const { width, height } = svg.getBoundingClientRect();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.columns = ["initial", ...this.between(graph, 0), "suction", ...this.between(graph, 1), "goal"];
    this.lay(width, height);
    const grasps = this.considered.grasps;
    for (const [arm, hand] of graph.arms.entries()) {
      const [, y] = this.place("initial", arm * grasps);
      draw(svg, "text", { x: 4, y: y + 4, class: "band" }, `${hand} hand`);
    }
    for (const column of this.columns) this.column(svg, graph, column);
    const chosen = new Set(graph.sequence);
    graph.edges.forEach((edge, number) => chosen.has(number) || this.edge(svg, graph, edge, edge.state));
    for (const number of graph.sequence) this.edge(svg, graph, graph.edges[number], "chosen");
  }

  /** A column of handovers, where one was tried in a round. */
  between(graph, round) {
    return graph.edges.some((edge) => edge.kind === "handover" && edge.round === round) ? [HANDOVERS[round]] : [];
  }

  /** Divide the picture: a block of dots for each column and arm. */
  lay(width, height) {
    const [left, top, gap] = [64, 46, 18];
    const pitch = (width - left - 26) / this.columns.length;
    const block = { width: Math.min(0.52 * pitch, 170), height: (height - top - gap - 6) / 2 };
    const cell = Math.min(Math.sqrt((block.width * block.height) / this.considered.grasps), 13);
    const across = Math.max(1, Math.floor(block.width / cell));
    const rows = Math.ceil(this.considered.grasps / across);
    const step = Math.min(cell, block.height / rows);
    this.grid = { left: left + 0.5 * (pitch - across * step), top, pitch, across, step, band: block.height + gap };
  }

  /** Where a node is in a column. */
  place(column, node) {
    const { left, top, pitch, across, step, band } = this.grid;
    const grasp = node % this.considered.grasps;
    const arm = Math.floor(node / this.considered.grasps);
    return [
      left + this.columns.indexOf(column) * pitch + (grasp % across + 0.5) * step,
      top + arm * band + (Math.floor(grasp / across) + 0.5) * step,
    ];
  }

  column(svg, graph, column) {
    const [title, small] = COLUMN_TITLES[column];
    const x = this.place(column, 0)[0] + 0.5 * (this.grid.across - 1) * this.grid.step;
    // Where columns are narrow, titles take turns between two lines.
    const narrow = this.grid.pitch < NARROW_PITCH;
    draw(svg, "text", { x, y: narrow && this.columns.indexOf(column) % 2 ? 29 : 14, class: "title" }, title);
    if (!narrow) draw(svg, "text", { x, y: 29, class: "small" }, small || this.goalWords(graph));
    const radius = 0.5 * this.grid.step;
    const nodes = graph.arms.length * this.considered.grasps;
    const asked = this.asked(graph, column);
    for (let node = 0; node < nodes; node += 1) {
      const [cx, cy] = this.place(column, node);
      const { fill = UNASKED, words = "", size = 0.45 } = asked.get(node) ?? {};
      const dot = draw(svg, "circle", { cx, cy, r: size * radius, fill });
      if (words) draw(dot, "title", {}, words);
    }
  }

  goalWords(graph) {
    const count = graph.layers.filter(({ layer }) => layer === "goal").length;
    return count > 1 ? `one of ${count} alike that were asked` : "";
  }

  /** What is known of the nodes of a column. */
  asked(graph, column) {
    const known = new Map();
    const hand = (node) => graph.arms[Math.floor(node / this.considered.grasps)];
    for (const layer of this.layers(graph, column)) {
      for (const [reason, nodes] of Object.entries(layer.rejected))
        for (const node of nodes) known.set(node, { fill: this.colours[reason], words: `${hand(node)} hand: ${reason}`, size: 0.55 });
      for (const node of layer.possible) known.set(node, { fill: this.colours[hand(node)], words: `${hand(node)} hand: possible`, size: 0.85 });
    }
    return known;
  }

  /** The layers that a column shows: of several goals, the one that was chosen or the first. */
  layers(graph, column) {
    const layers = graph.layers.filter(({ layer }) => layer === column);
    const used = graph.sequence.map((number) => graph.edges[number].goal).find((goal) => goal !== null);
    return column === "goal" ? [layers.find(({ goal }) => goal === used) ?? layers[0]].filter(Boolean) : layers;
  }

  /** Draw an edge: chosen, deleted, or with a motion that was not needed in the end. */
  edge(svg, graph, edge, state) {
    const [from, to] = this.ends(graph, edge);
    const [x1, y1] = edge.from === null ? [0, 0] : this.place(from, edge.from);
    const [x2, y2] = this.place(to, edge.to);
    const bend = from === to ? 26 : 0.45 * (x2 - x1);
    const path = edge.from === null
      ? `M${x2 - 34},${y2} L${x2 - 4},${y2}`
      : `M${x1},${y1} C${x1 + bend},${y1} ${x2 - (from === to ? -bend : bend)},${y2} ${x2},${y2}`;
    const line = { d: path, class: `edge ${state}` };
    if (state === "deleted") line.style = `stroke: ${this.colours[edge.reason]}`;
    if (state === "chosen") draw(svg, "path", { d: path, class: "halo" });
    const drawn = draw(svg, "path", line);
    draw(drawn, "title", {}, `${this.edgeWords(graph, edge)}${edge.reason ? `: ${edge.reason}` : ""}`);
    if (state !== "chosen") return;
    for (const [x, y] of [[x2, y2], ...(edge.from === null ? [] : [[x1, y1]])]) draw(svg, "circle", { cx: x, cy: y, r: 4.5, class: "visited" });
  }

  /** Between which columns an edge runs. */
  ends(graph, { kind, round, from }) {
    const handover = HANDOVERS[round];
    const begin = round ? "suction" : "initial";
    const received = graph.edges.some((edge) => edge.kind === "handover" && edge.round === round && edge.to === from);
    const starts = this.layers(graph, begin).some(({ possible }) => possible.includes(from));
    const source = received && (kind === "transfer" || !starts) ? handover : begin;
    if (kind === "pick") return ["initial", "initial"];
    if (kind === "handover") return [source, handover];
    return [source, round ? "goal" : "suction"];
  }

  /** What the colours of dots and lines mean in this graph. */
  key(graph) {
    const counts = new Map();
    const count = (reason, number) => counts.set(reason, (counts.get(reason) ?? 0) + number);
    for (const column of ["initial", "suction", "goal"])
      for (const layer of this.layers(graph, column))
        for (const [reason, nodes] of Object.entries(layer.rejected)) count(reason, nodes.length);
    const deleted = new Map();
    for (const { reason, state } of graph.edges) if (state === "deleted") deleted.set(reason, (deleted.get(reason) ?? 0) + 1);
    const list = element("ul", { className: "key" });
    const row = (className, colour, words) => {
      const mark = element("i", { className });
      mark.style.cssText = className === "line" ? `border-color: ${colour}` : `background: ${colour}`;
      list.append(element("li", {}, mark, words));
    };
    for (const arm of graph.arms) row("dot", this.colours[arm], `${arm} hand can`);
    row("dot", UNASKED, "not asked");
    if (graph.sequence.length) row("line solid", "var(--ink)", "chosen sequence");
    for (const [reason, number] of [...counts].sort((a, b) => b[1] - a[1])) row("dot", this.colours[reason], `${sentence(reason)} (${number.toLocaleString("en")})`);
    for (const [reason, number] of deleted) row("line", this.colours[reason], `edge deleted: ${sentence(reason)} (${number})`);
    return list;
  }
}

/** Add an SVG element. */
function draw(parent, tag, attributes, words = "") {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = words;
  parent.append(made);
  return made;
}

function plain(name) {
  return name.replaceAll("_", " ");
}

/** A reason without its full stop. */
function sentence(words) {
  return words.replace(/\.$/, "");
}
