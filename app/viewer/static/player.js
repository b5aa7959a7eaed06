/* The page's clock, and everything that follows it: scene, timeline, curves, words. */
"use strict";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const SOURCES = ["plan", "simulation", "execution"];

/** How often the address is made to lead to what is shown. */
const ADDRESS_MILLISECONDS = 500;

/** What the address says of a moment: the time [s], what is played, and the camera: its place and target [m]. */
function readMoment() {
  const told = new URLSearchParams(location.hash.slice(1));
  const numbers = (told.get("camera") ?? "").split(",").map(Number);
  const time = Number(told.get("t") ?? NaN);
  return { time: Number.isFinite(time) ? time : null, source: SOURCES.includes(told.get("source")) ? told.get("source") : "plan",
    camera: numbers.length === 6 && numbers.every(Number.isFinite) ? numbers : null };
}

class Player {
  /** @param scene what draws: show(source, time), look(view), and what the panel asks of it */
  constructor(scene) {
    this.scene = scene;
    this.time = 0;
    this.playing = false;
    this.timeline = new TimelineBar((time) => this.seek(time));
    this.panel = new Panel(scene, (time) => this.visit(time));
    document.getElementById("play").onclick = () => this.play(!this.playing);
    document.getElementById("previous").onclick = () => this.jump(-1);
    document.getElementById("next").onclick = () => this.jump(1);
    for (const name of SOURCES) document.getElementById(`source-${name}`).onclick = () => this.choose(name);
    for (const button of document.querySelectorAll("#panes button")) button.onclick = () => showPane(button.dataset.pane);
    showPane("panel");
    window.addEventListener("keydown", (event) => this.key(event), true);
  }

  /** What is played: the plan or its simulation, with its duration, segments and curves. */
  get source() {
    return this.description?.sources[this.sourceName];
  }

  /** Show no plan, or one that there is only a name of. */
  close(title) {
    this.play(false);
    this.description = this.captioned = null;
    document.body.classList.add("empty");
    document.title = `${title} · Liftwright`;
    document.getElementById("title").textContent = title;
  }

  /** Show a plan from its start. */
  open(description) {
    this.description = description;
    document.body.classList.remove("empty");
    document.body.classList.toggle("still", !description.sources.plan.duration);
    this.time = 0;
    this.play(false);
    this.colours = description.colours;
    this.charts ??= new Charts(document.getElementById("charts"), this.colours, (time) => this.seek(time));
    this.panel.show(description);
    this.headline();
    document.getElementById("sources").hidden = Object.keys(description.sources).length < 2;
    for (const name of SOURCES) document.getElementById(`source-${name}`).hidden = !description.sources[name];
    document.getElementById("source-simulation").textContent = description.simulation_words;
    this.choose("plan");
  }

  /** Play what comes after this in the row of what can be played. */
  chooseNext() {
    const there = SOURCES.filter((name) => this.description.sources[name]);
    this.choose(there[(there.indexOf(this.sourceName) + 1) % there.length]);
  }

  /** Play the plan, its simulation or its execution, from the time that is shown now. */
  choose(name) {
    if (!this.description.sources[name]) return;
    this.sourceName = name;
    for (const other of SOURCES) document.getElementById(`source-${other}`).setAttribute("aria-checked", String(other === name));
    this.charts.show(this.source);
    this.timeline.show(this.source, this.colours);
    this.seek(this.time);
  }

  /** What the address has to say of the moment that is shown; nothing of the plan's begin. */
  get moment() {
    const parts = this.time > 0 || this.sourceName !== "plan" ? [`t=${Number(this.time.toFixed(2))}`] : [];
    return this.sourceName === "plan" ? parts : [...parts, `source=${this.sourceName}`];
  }

  /** Show a moment that an address tells of. */
  visitMoment({ time, source }) {
    if (time === null) return;
    this.choose(source);
    this.seek(time);
  }

  headline() {
    const { description } = this;
    document.title = `${description.title} · Liftwright`;
    Object.assign(document.getElementById("title"), { textContent: description.title, title: description.title });
    Object.assign(document.getElementById("subtitle"), { textContent: description.subtitle, title: description.subtitle });
    const badge = document.getElementById("outcome");
    Object.assign(badge, { hidden: false, className: `badge ${description.outcome}`, textContent: description.outcome_words });
    const { simulation } = description;
    const simulated = document.getElementById("simulated");
    simulated.hidden = !simulation;
    if (simulation) {
      const className = `badge ${simulation.good ? "solved" : "failed"}`;
      Object.assign(simulated, { className, textContent: `simulated: ${simulation.words}`, title: simulation.sentence });
    }
    const { execution } = description;
    const executed = document.getElementById("executed");
    executed.hidden = !execution;
    if (execution) Object.assign(executed, { className: `badge ${execution.good ? "solved" : "failed"}`, textContent: execution.words });
    document.getElementById("highlights").replaceChildren(
      ...description.highlights.map(([label, value]) =>
        element("div", {}, element("dt", { textContent: label }), element("dd", { textContent: value }))),
    );
    const message = document.getElementById("message");
    message.className = "low";
    // Where it is longer than its place it is scrolled, by keys too.
    message.tabIndex = 0;
    message.replaceChildren(...(description.outcome === "solved" ? [] : explanation(description)));
  }

  play(on) {
    if (on && !this.source?.duration) return;
    if (on && this.time >= this.source.duration - 1e-6) this.time = 0;
    this.playing = on;
    const button = document.getElementById("play");
    button.classList.toggle("on", on);
    button.setAttribute("aria-label", on ? "Pause" : "Play");
    if (!on) return;
    let last = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      this.time += (Math.max(0, now - last) / 1000) * Number(document.getElementById("speed").value);
      last = now;
      if (this.time >= this.source.duration && !this.goOn()) {
        this.time = this.source.duration;
        this.play(false);
      }
      this.refresh();
      if (this.playing) requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  /** At the plan's end, go on with the lift that was simulated. */
  goOn() {
    const { simulation } = this.description.sources;
    if (this.sourceName !== "plan" || !simulation?.segments.some(({ kind }) => kind === "lift")) return false;
    this.choose("simulation");
    return true;
  }

  seek(time) {
    if (!this.description) return;
    this.time = Math.min(Math.max(time, 0), this.source.duration);
    this.refresh();
  }

  /** Go to a time of the plan. */
  visit(time) {
    this.play(false);
    this.choose("plan");
    this.seek(time);
  }

  /** Go to a neighbouring segment's start; back first goes to the start of the one that runs. */
  jump(direction) {
    const segments = this.source?.segments ?? [];
    if (!segments.length) return;
    const here = this.timeline.segmentAt(this.time);
    const into = this.time - segments[here].start;
    const target = direction < 0 && into > 0.3 ? here : here + direction;
    this.seek(target >= segments.length ? this.source.duration : segments[Math.max(target, 0)].start);
  }

  refresh() {
    const { source, time } = this;
    this.scene.show(this.sourceName, time);
    const segment = this.timeline.segmentAt(time);
    this.timeline.now(time, segment);
    this.charts.now(time);
    document.getElementById("clock").replaceChildren(
      `${time.toFixed(2)} s`, element("small", { textContent: ` / ${source.duration.toFixed(1)}` }));
    if (source.segments[segment] !== this.captioned) this.caption(source.segments[segment]);
    this.tellEnding(this.sourceName === "simulation" && time >= source.duration - 1e-3);
  }

  /** Say which segment runs. */
  caption(segment) {
    this.captioned = segment;
    this.panel.regrasp.follow(segment?.state);
    const now = document.getElementById("now");
    if (!segment) return now.replaceChildren();
    const { kind, words, state, hold } = segment;
    const mark = element("i");
    mark.style.background = this.colours[kind];
    now.replaceChildren(element("b", {}, mark, words), element("span", { textContent: state }), element("span", { textContent: hold }));
  }

  /** Say how the simulation ended, once it has. */
  tellEnding(ended) {
    const ending = document.getElementById("ending");
    ending.hidden = !ended;
    if (!ended) return;
    const { words, good, sentence } = this.description.simulation;
    ending.className = good ? "good" : "bad";
    ending.replaceChildren(element("b", { textContent: capitalised(words) }), sentence);
  }

  /** Keys of the player; those it takes do not reach the scene's camera. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.description) return;
    if (isTypedInto(event.target) || (event.target.tagName === "SELECT" && !["[", "]"].includes(event.key))) return;
    const step = event.shiftKey ? 2 : 0.2;
    const speed = document.getElementById("speed");
    const faster = (by) => (speed.value = SPEEDS[Math.min(Math.max(SPEEDS.indexOf(Number(speed.value)) + by, 0), SPEEDS.length - 1)]);
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.seek(this.time - step),
      ArrowRight: () => this.seek(this.time + step),
      Home: () => this.seek(0),
      End: () => this.seek(this.source.duration),
      "[": () => this.jump(-1),
      "]": () => this.jump(1),
      "+": () => faster(1),
      "-": () => faster(-1),
      r: () => this.panel.regrasp.toggle(),
      Escape: () => this.panel.regrasp.toggle(false),
      p: () => this.chooseNext(),
    };
    VIEWS.forEach((view, index) => (actions[index + 1] = () => this.scene.look(view)));
    for (const [name, , key] of this.panel.layerRows) actions[key.toLowerCase()] = () => this.panel.toggle(name);
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    const spaceIsTheirs = event.target.role === "tab" || event.target.type === "checkbox";
    if (!action || (spaceIsTheirs && event.key === " ")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    action();
  }
}

/** Add the buttons that move the camera of a scene. */
function addCameraButtons(scene) {
  VIEWS.forEach((view, index) =>
    document.getElementById("views").append(
      element("button", { textContent: capitalised(view), title: `${capitalised(view)}  ${index + 1}`, onclick: () => scene.look(view) })));
}

/** Whether keys pressed in an element write into it. */
function isTypedInto(target) {
  return target.tagName === "TEXTAREA" || (target.tagName === "INPUT" && !["range", "checkbox", "radio", "button"].includes(target.type));
}

/** Where there is room for one of list, curves and panel only: which it is. */
function showPane(pane) {
  document.body.dataset.pane = pane;
  for (const button of document.querySelectorAll("#panes button")) button.setAttribute("aria-pressed", String(button.dataset.pane === pane));
}

function explanation(description) {
  const causes = description.causes.map(({ reason, numbers }) =>
    element("li", {}, reason, ...(numbers ? [element("em", { textContent: numbers })] : [])));
  return [element("h3", {}, capitalised(description.outcome_words), element("small", { textContent: description.outcome_meaning })),
    element("p", { textContent: description.summary }), element("ul", {}, ...causes),
    ...(description.remedies?.length ? [element("p", { textContent: `Changes of the task were tried: ${description.remedies.length === 1 ? "one leads" : `${description.remedies.length} lead`} to a plan; see What to change.` })] : [])];
}
