/* Two plans side by side: a scene each, one clock for both, and what they differ in. */
"use strict";

const SIDES = ["left", "right"];
const LIGHT = drawsLightly();
/** Of numbers of tasks, by the name of the member. */
const UNITS = {
  mass: "kg", size: "m", radius: "m", height: "m", outline: "m", position: "m", com: "m", com_tolerance: "m", goal_height: "m", eps: "m",
  max_force: "N", kappa: "N", normal: "N", net: "N", squeeze: "N", start_positions: "rad",
  plate_pose: "m; w, x, y, z", pose: "m; w, x, y, z", goal_pose: "m; w, x, y, z", tool_pose: "m; w, x, y, z",
};
const byId = (id) => document.getElementById(id);

/** One of the two plans: its scene, and what is told of it. */
class PlanSide {
  constructor(name, onchange) {
    Object.assign(this, { name, onchange, plan: null, description: null, task: null });
    this.frame = byId(`${name}-scene`);
    this.box = this.frame.parentElement;
    this.chooser = byId(`${name}-plan`);
    this.badge = this.chooser.parentElement.querySelector(".badge");
    this.link = this.chooser.parentElement.querySelector("a");
    this.connection = new Connection();
    this.connection.onscene = (scene) => {
      this.connection.detail(LIGHT);
      this.frame.src = frameAddress(scene, LIGHT);
      if (this.plan) this.load(this.plan);
      else this.say("Choose a plan above.");
    };
    this.connection.onplan = (description) => description.id === this.plan && this.opened(description);
    this.connection.onrefused = ({ detail }) => this.say(detail);
    this.connection.onfault = (detail) => this.say(detail);
    this.connection.onlost = (words) => this.say(words);
    this.connection.onperceived = () => {};
    this.chooser.onchange = () => this.load(this.chooser.value);
    adoptFrame(this.frame, (event) => comparison.key(event));
  }

  load(plan) {
    Object.assign(this, { plan, description: null, task: null });
    this.chooser.value = plan;
    this.badge.hidden = true;
    this.say("Loading …");
    this.onchange();
    // One that is broken is made anew; its scene asks for the plan.
    if (this.connection.ready || this.connection.broken) this.connection.load(plan);
  }

  async opened(description) {
    this.description = description;
    this.say();
    Object.assign(this.badge, { hidden: false, className: `badge ${description.outcome}`, textContent: description.outcome_words });
    this.onchange();
    const answer = await fetch(`../v1/plans/${description.id}/document`);
    if (answer.ok && this.description === description) {
      this.task = (await answer.json()).task;
      this.onchange();
    }
  }

  get duration() {
    return this.description?.sources.plan.duration ?? 0;
  }

  show(time) {
    if (!this.description) return;
    this.connection.show("plan", Math.min(time, this.duration));
    const segment = this.description.sources.plan.segments.findLast(({ start }) => start <= time + 1e-9);
    this.box.querySelector(".now").textContent = time >= this.duration ? `at its end, ${this.duration.toFixed(1)} s` : [segment?.words, segment?.state].filter(Boolean).join(", ");
  }

  say(words = "") {
    this.box.querySelector(".message").textContent = words;
  }
}

class Comparison {
  constructor() {
    this.time = 0;
    this.playing = false;
    this.sides = SIDES.map((name) => new PlanSide(name, () => this.changed()));
    const wanted = (new URLSearchParams(location.search).get("plans") ?? "").split(",");
    this.sides.forEach((side, index) => (side.plan = wanted[index] || null));
    byId("play").onclick = () => this.play(!this.playing);
    byId("time").oninput = () => this.seek(byId("time").valueAsNumber);
    byId("pace").onchange = () => this.seek(this.time);
    byId("all-rows").onchange = () => this.tell();
    byId("swap").onclick = () => {
      const [left, right] = this.sides.map(({ plan }) => plan);
      if (right) this.sides[0].load(right);
      if (left) this.sides[1].load(left);
    };
    window.addEventListener("keydown", (event) => this.key(event));
    this.fillChoosers();
  }

  async fillChoosers() {
    const answer = await fetch("../v1/plans?page_size=200&state=succeeded");
    const plans = answer.ok ? (await answer.json()).plans : [];
    // What is compared may be older than those that are listed.
    const known = new Set(plans.map(({ id }) => id));
    const older = [...new Set(this.sides.map(({ plan }) => plan))].filter((plan) => plan && !known.has(plan));
    const told = await Promise.all(older.map((plan) => fetch(`../v1/plans/${encodeURIComponent(plan)}`).then((found) => (found.ok ? found.json() : { id: plan }))));
    for (const side of this.sides) {
      side.chooser.replaceChildren(element("option", { value: "", textContent: "…", disabled: true }), ...[...told, ...plans].map((plan) => element("option", { value: plan.id, textContent: nameOf(plan) })));
      side.chooser.value = side.plan ?? "";
    }
  }

  /** How long the clock runs: as long as the longer plan. */
  get duration() {
    return Math.max(...this.sides.map(({ duration }) => duration));
  }

  changed() {
    const plans = this.sides.map(({ plan }) => plan ?? "");
    history.replaceState(null, "", `?plans=${plans.join(",")}`);
    for (const { link, plan, name } of this.sides) Object.assign(link, { hidden: !plan, href: `./?plan=${encodeURIComponent(plan)}`, ariaLabel: `Open the ${name} plan` });
    byId("time").max = this.duration || 1;
    this.seek(Math.min(this.time, this.duration));
    this.tell();
  }

  seek(time) {
    this.time = time;
    const share = byId("pace").value === "share" && this.duration ? time / this.duration : null;
    for (const side of this.sides) side.show(share === null ? time : share * side.duration);
    byId("time").value = time;
    byId("clock").textContent = share === null ? `${time.toFixed(1)} s` : `${Math.round(100 * share)} %`;
  }

  play(on) {
    if (on && !this.duration) return;
    if (on && this.time >= this.duration) this.time = 0;
    this.playing = on;
    byId("play").textContent = on ? "Pause" : "Play";
    let last = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const time = this.time + (Math.max(0, now - last) / 1000) * Number(byId("speed").value);
      last = now;
      this.seek(Math.min(time, this.duration));
      if (time >= this.duration) this.play(false);
      else requestAnimationFrame(tick);
    };
    if (on) requestAnimationFrame(tick);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || ["BUTTON", "SELECT", "INPUT"].includes(event.target.tagName)) return;
    const step = event.shiftKey ? 2 : 0.2;
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.seek(Math.max(0, this.time - step)),
      ArrowRight: () => this.seek(Math.min(this.duration, this.time + step)),
      Home: () => this.seek(0),
      End: () => this.seek(this.duration),
    };
    if (!actions[event.key]) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    actions[event.key]();
  }

  /** Tables of what the two differ in: what came of them, their figures, their tasks. */
  tell() {
    const [left, right] = this.sides.map(({ description }) => description);
    if (!left || !right) return byId("tables").replaceChildren(element("p", { textContent: "What two plans differ in is told here, once there are two: choose one on each side above." }));
    const all = byId("all-rows").checked;
    const groups = [["In short", [["outcome", left.outcome_words, right.outcome_words], ...joined(left.highlights, right.highlights)]]];
    const [before, after] = this.sides.map(({ task }) => task);
    if (before && after) groups.push(["Task", joined(flattened(before), flattened(after))]);
    const titles = [...new Set([...left.figures, ...right.figures].map(({ title }) => title))];
    const rows = (description, title) => description.figures.filter((group) => group.title === title).flatMap((group) => headed(group.rows));
    for (const title of titles) groups.push([title, joined(rows(left, title), rows(right, title))]);
    const tables = groups.map(([title, found]) => [title, found.filter(([, one, other]) => all || one !== other)]).filter(([, found]) => found.length);
    byId("tables").replaceChildren(...(tables.length ? tables.map(([title, found]) => this.table(title, found)) : [element("p", { textContent: "The two are the same in all that is told of them." })]));
  }

  table(title, rows) {
    const names = this.sides.map(({ description }) => description.title);
    const head = element("tr", {}, ...["", ...names, "change"].map((words) => element("th", { textContent: words, scope: "col" })));
    return element("table", {}, element("caption", { textContent: title }), element("thead", {}, head), element("tbody", {}, ...rows.map(([label, one, other]) =>
      element("tr", { className: one === other ? "" : "differs" }, element("th", { textContent: label, scope: "row" }), element("td", { textContent: one }), element("td", { textContent: other }), element("td", { className: "change", textContent: change(one, other) })))));
  }
}

/** What a plan is called in a list: its name, what came of it, and when it was asked for, as far as that is known. */
function nameOf({ id, external_id, outcome, created_at }) {
  return [external_id ?? id.slice(0, 8), outcome?.replace("_", " "), created_at && dated(created_at)].filter(Boolean).join(", ");
}

/** Rows of several columns with the words of their heading beside each number; others as they are. */
function headed([head, ...rows]) {
  if (!head || head[0] !== "") return head ? [head, ...rows] : [];
  return rows.map(([label, ...values]) => [label, ...values.map((value, column) => `${value} ${head[column + 1]}`)]);
}

/** Rows [label, value, …] of two plans side by side, by their labels; what one has not is a dash. */
function joined(left, right) {
  const values = (rows) => new Map(rows.map(([label, ...rest]) => [label, rest.join(", ")]));
  const [one, other] = [values(left), values(right)];
  return [...new Set([...one.keys(), ...other.keys()])].map((label) => [label, one.get(label) ?? "—", other.get(label) ?? "—"]);
}

/** A pointer into a task in words, with the unit of what is there. */
function worded(pointer) {
  const steps = pointer.split("/").slice(1);
  const isIndex = (step) => /^\d+$/.test(step);
  const unit = UNITS[steps.findLast((step) => !isIndex(step))];
  const words = steps.map((step) => (isIndex(step) ? ` ${Number(step) + 1}` : `, ${step.replaceAll("_", " ")}`)).join("").slice(2);
  return unit ? `${words} [${unit}]` : words;
}

/** All members of a task as rows [words, value]; arrays of numbers are one value. */
function flattened(value, pointer = "") {
  const isLeaf = value === null || typeof value !== "object" || (Array.isArray(value) && value.every((each) => typeof each === "number"));
  if (isLeaf) return [[worded(pointer), Array.isArray(value) ? value.join(", ") || "none" : value === null ? "none" : String(value)]];
  return Object.entries(value).flatMap(([key, part]) => flattened(part, `${pointer}/${key}`));
}

/** How much more the second is, of values that are a number with the same unit. */
function change(one, other) {
  const [first, second] = [one, other].map((text) => /^(-?[\d,]+(?:\.\d+)?)\s*(\S*)$/.exec(text));
  if (!first || !second || first[2] !== second[2] || one === other) return "";
  const [a, b] = [first, second].map(([, digits]) => Number(digits.replaceAll(",", "")));
  const places = Math.max(...[first, second].map(([, digits]) => digits.split(".")[1]?.length ?? 0));
  return `${b > a ? "+" : "−"}${Math.abs(b - a).toFixed(places)} ${first[2]}`.trim();
}

const comparison = new Comparison();
