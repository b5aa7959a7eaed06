"use strict";
// The page of a study: its map, painted onto the plate where cup places are varied; a point opens as a plan.

const SVG = "http://www.w3.org/2000/svg";
const FULL_RESERVE = 0.2; // The brightest colour, as in the picture.
const VIRIDIS = getComputedStyle(document.documentElement).getPropertyValue("--viridis").match(/#\w{6}/g)
  .map((code) => [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16)));
const WORDS = { solved: "solved", not_found: "not found", infeasible: "proven infeasible", refused: "no such task can be", failed: "failed" };
const MARKS = { not_found: "M.25 .75L.75 .25", infeasible: "M.25 .75L.75 .25M.25 .25L.75 .75", refused: "M.48 .5L.52 .5", failed: "M.5 .2L.5 .6M.5 .75L.5 .8" };
const NAMES = { "/cup/position/0": "cup, x on the plate [m]", "/cup/position/1": "cup, y on the plate [m]", "/cup/max_force": "cup force [N]", "/lifter_model": "lifter model" };

const byId = (id) => document.getElementById(id);
const wanted = new URLSearchParams(location.search).get("study");
const points = new Map();
let study = null, map = null, chosen = null, size = [1, 1];

function colour(reserve) {
  const at = Math.min(1, Math.max(0, reserve / FULL_RESERVE)) * (VIRIDIS.length - 1);
  const low = Math.min(VIRIDIS.length - 2, Math.floor(at));
  return VIRIDIS[low].map((value, k) => Math.round(value + (at - low) * (VIRIDIS[low + 1][k] - value)));
}

/** Make an element of a drawing. */
function drawn(name, attributes = {}, parent = null) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

const shown = (value) => typeof value === "number" ? String(Number(value.toPrecision(3))) : typeof value === "string" ? value : JSON.stringify(value);
const nameOf = (axis) => (NAMES[axis.pointer] ?? axis.pointer) + (axis.part === "yaw" ? ", turned [rad]" : "");
const percent = (reserve) => `${(100 * reserve).toFixed(1)} %`;

async function call(path, method = "GET") {
  const answer = await fetch(path, { method, headers: { Accept: "application/json" } });
  const body = answer.status === 204 ? null : await answer.json();
  if (!answer.ok) throw new Error(body?.detail ?? `the service answered ${answer.status}`);
  return body;
}

// Where points are: on the plate as seen from above, robot below; or on a grid.
function layout() {
  const [first, second] = map.axes;
  const numeric = (axis) => axis && axis.part === "value" && axis.values.length > 1 && axis.values.every((value) => typeof value === "number");
  const cup = second && ["/cup/position/0", "/cup/position/1"].every((each) => map.axes.some((axis) => axis.pointer === each && numeric(axis)));
  if (!cup) {
    const rows = second ? second.values.length : 1;
    return { plate: null, size: [1, 1], at: ([column, row = 0]) => [column, rows - 1 - row], box: [-1.6, -0.4, first.values.length + 2, rows + 1.4] };
  }
  const x = map.axes.findIndex((axis) => axis.pointer === "/cup/position/0"), y = 1 - x;
  const step = (axis) => Math.min(...axis.values.slice(1).map((value, k) => Math.abs(value - axis.values[k])));
  const shape = map.task.plate.shape;
  const outline = shape.type === "box"
    ? [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => [a * shape.size[0] / 2, b * shape.size[1] / 2])
    : shape.outline;
  const [, , , w, , , z] = map.task.plate_pose;
  const yaw = 2 * Math.atan2(z, w);
  const turned = outline.flatMap(([a, b]) => [a * Math.cos(yaw) - b * Math.sin(yaw), a * Math.sin(yaw) + b * Math.cos(yaw)]);
  const reach = 1.06 * Math.max(...turned.map(Math.abs), ...map.axes.flatMap((axis) => axis.values.map(Math.abs)));
  return {
    // World x is up and y to the left: as whoever stands behind the robot sees it.
    plate: outline.map(([a, b]) => [-b, -a]), yaw, size: [step(map.axes[y]), step(map.axes[x])],
    at: (place) => [-map.axes[y].values[place[y]] - step(map.axes[y]) / 2, -map.axes[x].values[place[x]] - step(map.axes[x]) / 2],
    box: [-reach, -reach, 2 * reach, 2.12 * reach],
  };
}

function draw() {
  const drawing = byId("drawing"), where = layout();
  drawing.replaceChildren();
  drawing.setAttribute("viewBox", where.box.join(" "));
  const group = drawn("g", where.yaw ? { transform: `rotate(${-where.yaw * 180 / Math.PI})` } : {}, drawing);
  const [width, height] = size = where.size;
  if (where.plate) {
    drawn("polygon", { class: "plate", points: where.plate.map((each) => each.join(",")).join(" ") }, group);
    const robot = drawn("text", { x: 0, y: where.box[1] + where.box[3] * 0.985, "text-anchor": "middle", "font-size": where.box[2] / 34, style: `font-size:${where.box[2] / 34}px` }, drawing);
    robot.textContent = "robot";
  } else {
    labels(drawing);
  }
  const counts = map.axes.map((axis) => axis.values.length);
  for (let index = 0; index < map.count; index++) {
    const place = counts.length === 1 ? [index] : [Math.floor(index / counts[1]), index % counts[1]];
    const [x, y] = where.at(place);
    const cell = drawn("g", { id: `point-${index}`, role: "button", tabindex: index === (chosen ?? 0) ? 0 : -1, transform: `translate(${x} ${y}) scale(${width} ${height})` }, group);
    cell.addEventListener("click", () => choose(index, true));
    cell.addEventListener("keydown", (event) => keys(event, index, place, counts, Boolean(where.plate)));
    cell.addEventListener("focus", () => choose(index, false));
    fill(index);
  }
}

function labels(drawing) {
  const [first, second] = map.axes, rows = second ? second.values.length : 1;
  const write = (text, x, y, anchor) => { drawn("text", { x, y, "text-anchor": anchor, style: "font-size:.24px" }, drawing).textContent = text; };
  first.values.forEach((value, column) => write(shown(value).slice(0, 10), column + .5, rows + .35, "middle"));
  if (second) second.values.forEach((value, row) => write(shown(value).slice(0, 10), -.12, rows - row - .42, "end"));
}

function fill(index) {
  const cell = byId(`point-${index}`);
  if (!cell) return;
  const point = points.get(index);
  cell.replaceChildren();
  const square = drawn("rect", { width: 1, height: 1 }, cell);
  const best = map.best?.index === index;
  cell.setAttribute("class", `cell ${point ? (point.outcome === "solved" ? "solved" : "unsolved") : "unknown"}${best ? " best" : ""}${chosen === index ? " chosen" : ""}`);
  cell.setAttribute("aria-label", label(index));
  if (!point) return;
  if (point.outcome !== "solved") {
    drawn("path", { d: MARKS[point.outcome] }, cell);
    return;
  }
  const rgb = colour(point.reserve ?? 0);
  square.style.fill = `rgb(${rgb})`;
  // Squares may be wider than high: what is written in them is not.
  const [width, height] = size.map((side) => Math.min(...size) / side);
  const text = drawn("text", { transform: `translate(.5 ${.5 + .12 * height}) scale(${width} ${height})`, "text-anchor": "middle", style: `font-size:.36px;fill:${rgb[0] + rgb[1] + rgb[2] < 330 ? "#fff" : "#111"}` }, cell);
  text.textContent = Math.floor(100 * (point.reserve ?? 0) + 1e-9);
}

function valuesAt(index) {
  const counts = map.axes.map((axis) => axis.values.length);
  const place = counts.length === 1 ? [index] : [Math.floor(index / counts[1]), index % counts[1]];
  return map.axes.map((axis, k) => [nameOf(axis), shown(axis.values[place[k]])]);
}

function label(index) {
  const point = points.get(index);
  const what = point ? WORDS[point.outcome] + (point.reserve === null ? "" : `, ${percent(point.reserve)} kept back`) : "not known yet";
  return `${valuesAt(index).map((pair) => pair.join(" ")).join("; ")}: ${what}${map.best?.index === index ? ", best" : ""}`;
}

function keys(event, index, place, counts, plate) {
  if (event.key === "Enter" || event.key === " ") {
    event.preventDefault();
    openPoint(index);
    return;
  }
  // On the plate the first axis may go up; elsewhere it goes to the right.
  const up = plate && map.axes[0].pointer === "/cup/position/0";
  const moves = up
    ? { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] }
    : plate ? { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [1, 0], ArrowRight: [-1, 0] }
      : { ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };
  const move = moves[event.key];
  if (!move) return;
  event.preventDefault();
  const next = place.map((at, k) => Math.min(counts[k] - 1, Math.max(0, at + move[k])));
  byId(`point-${counts.length === 1 ? next[0] : next[0] * counts[1] + next[1]}`).focus();
}

function choose(index, focus) {
  const before = chosen;
  chosen = index;
  for (const each of [before, index]) {
    if (each === null) continue;
    byId(`point-${each}`).setAttribute("tabindex", each === index ? 0 : -1);
    byId(`point-${each}`).classList.toggle("chosen", each === index);
  }
  if (focus) byId(`point-${index}`).focus();
  describe();
}

function describe() {
  const list = byId("point"), point = points.get(chosen);
  list.replaceChildren();
  if (chosen === null) return;
  const rows = [...valuesAt(chosen), ["outcome", point ? WORDS[point.outcome] : "not known yet"]];
  if (point?.outcome === "solved") {
    if (point.reserve !== null) rows.push(["kept back", percent(point.reserve) + (point.limited_by ? `, least of ${point.limited_by}` : "")]);
    if (point.largest_force !== null) rows.push(["largest force", `${point.largest_force.toFixed(1)} N`]);
  } else if (point) {
    rows.push(["why", point.summary]);
  }
  if (point) rows.push(["examined", point.certified ? "planned, certified" : point.examined ? `${point.examined}, not certified` : "no"], ["time", `${point.seconds.toFixed(1)} s`]);
  for (const [name, value] of rows) {
    list.append(element("dt", {}, name), element("dd", { textContent: value }));
  }
  byId("open").disabled = !point || point.outcome === "refused";
}

async function openPoint(index) {
  byId("refusal").textContent = "";
  try {
    const plan = await planOfPoint(study.id, index);
    location.href = `./?plan=${plan.id}&study=${study.id}`;
  } catch (error) {
    byId("refusal").textContent = error.message;
  }
}

async function refresh() {
  map = await call(study.links.map);
  for (const point of map.points) points.set(point.index, point);
  byId("best").textContent = map.best ? `${valuesAt(map.best.index).map((pair) => pair.join(" ")).join("; ")}: ${map.best.why.replace(/ (N|%)(?= |$)/g, "\u00a0$1")}.` : "None is solved yet.";
  byId("open-best").hidden = !map.best;
  byId("note").textContent = map.certify ? "" : "Points are searched and not certified; a point that is opened is planned and certified, and where nothing was found, searched more densely.";
  legend();
}

function legend() {
  const list = byId("legend");
  list.replaceChildren();
  for (const [outcome, word] of Object.entries(WORDS)) {
    if (!map.outcomes[outcome] || outcome === "solved") continue;
    const sign = drawn("svg", { viewBox: "0 0 1 1", "aria-hidden": "true" });
    const cell = drawn("g", { class: "cell unsolved" }, sign);
    drawn("rect", { width: 1, height: 1 }, cell);
    drawn("path", { d: MARKS[outcome] }, cell);
    list.append(element("li", {}, sign, `${word}: ${map.outcomes[outcome]}`));
  }
  list.append(element("li", {}, `${map.outcomes.solved} of ${map.count} solved`));
}

function tell() {
  byId("state").textContent = study.done ? `${study.state}, ${study.known} of ${study.count} points` : `${study.state}: ${points.size} of ${study.count} points`;
  byId("cancel").hidden = study.done;
}

async function showStudy() {
  study = await call(`/v1/studies/${encodeURIComponent(wanted)}`);
  byId("json").href = study.links.map;
  byId("png").href = study.links.picture;
  for (const id of ["map", "side", "studies"]) byId(id).hidden = false;
  byId("list").hidden = true;
  await refresh();
  const of = map.task.external_id;
  byId("title").textContent = document.title = study.external_id ? `Study ${study.external_id}` : of ? `Study of ${of}` : "Study";
  const plate = layout().plate;
  byId("axes").textContent = plate ? "The plate from above: its x leads away from the robot, its y to the left, before it is turned" : map.axes.map(nameOf).join(" to the right, ") + (map.axes.length > 1 ? " upwards" : "");
  draw();
  tell();
  if (map.best) choose(map.best.index, false);
  byId("open").addEventListener("click", () => openPoint(chosen));
  byId("open-best").addEventListener("click", () => choose(map.best.index, true));
  byId("cancel").addEventListener("click", async () => { study = await call(study.links.cancel, "POST"); tell(); });
  if (!study.done) follow();
}

function follow() {
  const events = new EventSource(study.links.events);
  events.addEventListener("point", (event) => {
    const point = JSON.parse(event.data);
    points.set(point.index, point);
    fill(point.index);
    if (point.index === chosen) describe();
    tell();
  });
  events.addEventListener("finished", async (event) => {
    events.close();
    study = JSON.parse(event.data);
    await refresh();
    for (let index = 0; index < map.count; index++) fill(index);
    tell();
    if (chosen === null && map.best) choose(map.best.index, false);
  });
}

async function showList() {
  const page = await call("/v1/studies"), list = element("ul");
  for (const each of page.studies) {
    const name = each.external_id ?? `${each.kind === "plate_lift" ? "Plate lift" : "Suction tool"}, ${each.count} points`;
    const more = `${each.state}, ${each.known} of ${each.count} points, ${dated(each.created_at)}`;
    list.append(element("li", {}, element("a", { href: `study?study=${each.id}`, textContent: name }), element("small", {}, more)));
  }
  byId("list").append(list);
  if (page.studies.length) return;
  const line = element("code", {}, `liftwright study task.json --axis /cup/position/0=-0.1:0.1:8 --axis /cup/position/1=-0.1:0.1:8 --service ${location.origin}`);
  byId("list").append(element("p", {}, "No studies yet. The editor begins one of the cup's places on a plate; this one of whatever is varied: ", line));
}

(wanted ? showStudy() : showList()).catch((error) => {
  byId("state").textContent = error.message;
  if (study) return;
  // Without a study there is nothing else on the page.
  byId("list").replaceChildren(element("p", {}, `${error.message[0].toUpperCase()}${error.message.slice(1)}. `, element("a", { href: "study", textContent: "All studies" })));
});
