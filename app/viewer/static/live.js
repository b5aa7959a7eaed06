/* The live viewer: plans and perceived scenes from the service, what is drawn from a scene of one's own. */
"use strict";

/** How often the list is asked for, and how often while somebody waits for a plan. */
const POLL_MILLISECONDS = 3000;
const BUSY_MILLISECONDS = 800;
/** So long after a move the camera is asked for. */
const CAMERA_MILLISECONDS = 400;
const PAGE_SIZE = 50;
const DAY_MILLISECONDS = 24 * 3600 * 1000;
/** What programs are written for: the name in the interface, and in words. */
const PROGRAMS = [["ur", "for UR controllers"], ["ros2", "for ROS 2"], ["csv", "as CSV tables"]];

/** The connection of this page, which also asks for the camera, posts tasks, and draws lightly or fully. */
class LiveConnection extends Connection {
  look(view) {
    super.look(view);
    this.ask({ type: "camera" });
  }

  /** Ask where the camera is; the answer comes to `oncamera`. */
  askCamera() {
    if (this.ready && !this.queue.some(({ type }) => type === "camera")) this.ask({ type: "camera" });
  }

  /** Have a task planned. */
  post(task) {
    post(task);
  }

  isLight() {
    return light;
  }

  setLight(on) {
    setLight(on);
  }
}

const connection = new LiveConnection();
const player = new Player(connection);
const perceived = new Perceived(connection);
const frame = document.getElementById("scene-frame");
const list = document.getElementById("plan-list");
let wanted = new URLSearchParams(location.search).get("plan");
/* A watcher wants a plan or a perceived scene, never both. */
let wantedScene = wanted ? null : new URLSearchParams(location.search).get("scene");
/** The study from which the plan was opened, or of which it plans a point: its map is painted onto the plate. */
let study = wanted ? new URLSearchParams(location.search).get("study") : null;
/** That from which it was opened, alone: of no other's map it has to be told why it cannot be painted. */
const askedStudy = study;
let studyEvents = null;
let repainting = 0;
let loaded = null;
/** What is known of the plan that is wanted: a filter, or newer ones, may keep it out of the list. Null: nothing yet. */
let unlisted = null;
/** Whether the plan that is wanted was deleted. */
let deleted = false;
/** The plan at which the service met a fault: it is shown again when somebody chooses it, not by itself. */
let faulty = null;
/** Whether what is loaded has no simulation, and whether that is still made. */
let bare = false;
let simulating = false;
let plans = [];
let polling = 0;
/** The query whose answer is listed, and how many pages of it. */
let shownQuery = "";
let shownPages = 1;
const filter = document.getElementById("plan-filter");
let sceneAddress = "";
/** The moment that the address told of when the page was opened, until it is shown. */
let moment = wanted ? { ...readMoment(), plan: wanted } : null;
/** Where the camera is and what it looks at, if it was moved or the address tells. */
let camera = moment?.camera ?? null;
let asking = 0;
let light = drawsLightly();

connection.onscene = (scene) => {
  // The frame gets going while the plan is still read; until it is drawn, the cell is.
  sceneAddress = scene;
  loaded = null;
  connection.detail(light);
  showFrame();
  if (wanted) choose(wanted);
  else if (wantedScene) choosePerceived(wantedScene);
  else showEmpty();
};
adoptFrame(frame, (event) => (perceived.description ? perceived : player).key(event));
connection.onplan = (description, planned) => {
  if (description.id !== wanted) return;
  loaded = description.id;
  [bare, simulating] = [!description.simulation, false];
  // What can be shown already may still lack its simulation, or what to change.
  description.pending = mine()?.done === false;
  say();
  for (const [layer, visible] of Object.entries(player.panel.visible))
    if (visible !== FIRST_LAYERS.has(layer)) connection.layer(layer, visible);
  player.open(description);
  study ??= planned;
  if (study) connection.paint(study);
  if (moment) player.visitMoment(moment);
  moment = null;
  const base = `../v1/plans/${description.id}`;
  document.getElementById("links").replaceChildren(
    element("a", { href: `new?plan=${description.id}`, textContent: "Change this task", title: "Begin a new task with this one" }),
    element("a", { href: `compare?plans=${description.id}`, textContent: "Compare", title: "Beside another plan" }),
    ...(description.outcome === "solved" ? [programChoice(base)] : []),
    element("a", { href: `${base}/recording.html`, download: `${description.title}.html`, textContent: "Recording", title: "One file that plays offline" }),
    element("a", { href: `${base}/document`, target: "_blank", textContent: "Document", title: "The plan document" }),
    element("button", { textContent: "Delete", title: "Delete this plan", onclick: () => remove(description) }),
  );
};
connection.onperceived = (description) => {
  if (description.id !== wantedScene) return;
  say();
  perceived.open(description);
};
connection.onpainted = (painted) => {
  if (painted.study !== study) return;
  player.panel.tellStudy(painted);
  followStudy(painted);
};
connection.onpoint = (clicked, index) => clicked === study && openPoint(index);
connection.onrefused = ({ plan, scene, study: refused, detail }) => {
  // Nobody asked for the map of the study that a plan comes from; it may be none that can be painted.
  if (refused && refused === study) player.panel.tellStudy({ study, refusal: study === askedStudy ? detail : "The plan is of a point of a study." });
  if (scene && scene === wantedScene) say("Nothing to show", detail);
  if (plan && plan === wanted) say(...whyNot(mine(), detail));
};
connection.onfault = (detail) => {
  faulty = wanted;
  player.play(false);
  say("A fault of the service", detail, "Choose the plan again to try once more.");
};
connection.oncamera = (told) => {
  camera = told ?? camera;
  writeMoment();
};
connection.onlost = (words) => say("No connection", words);

addCameraButtons(connection);

function showFrame() {
  const address = frameAddress(sceneAddress, light, camera);
  if (frame.getAttribute("src") === address) return;
  frame.src = address;
  frame.addEventListener("load", watchCamera, { once: true });
  waitForPicture();
}
DARK.addEventListener("change", () => frame.hasAttribute("src") && showFrame());

/** Say that the scene is being drawn until its page has drawn something. */
function waitForPicture() {
  const drawing = document.getElementById("drawing");
  drawing.hidden = false;
  const page = frame.contentWindow;
  const look = () => {
    if (page !== frame.contentWindow) return;
    if (!frame.contentDocument?.querySelector("canvas")) return setTimeout(look, 100);
    // What is asked for after the next picture comes when that is drawn.
    frame.contentWindow.requestAnimationFrame(() => frame.contentWindow.requestAnimationFrame(() => (drawing.hidden = true)));
  };
  look();
}

/** Have the address lead to the moment and the camera that are shown now. */
function writeMoment() {
  if (loaded === null || loaded !== wanted || player.playing || moment) return;
  const parts = [...player.moment, ...(camera ? [`camera=${camera.join()}`] : [])];
  const address = `?${planQuery()}${parts.length ? `#${parts.join("&")}` : ""}`;
  if (location.search + location.hash !== address) history.replaceState(null, "", address);
}

/** What the address says of what is shown: the plan, and the study that it was opened from. */
function planQuery() {
  return `plan=${wanted}${study ? `&study=${encodeURIComponent(study)}` : ""}`;
}

/** Ask for the camera's place whenever somebody may have moved it. */
function watchCamera() {
  // A page that could not be loaded is somebody else's.
  if (!frame.contentDocument) return;
  const moved = () => {
    clearTimeout(asking);
    asking = setTimeout(() => connection.askCamera(), CAMERA_MILLISECONDS);
  };
  for (const kind of ["pointerup", "wheel", "keyup"]) frame.contentWindow.addEventListener(kind, moved, { passive: true });
}

/** Paint anew, now and then, while points of the study become known. */
function followStudy({ count, outcomes }) {
  const whole = Object.values(outcomes).reduce((sum, each) => sum + each, 0) === count;
  if (whole || studyEvents) return;
  const followed = (studyEvents = new EventSource(`../v1/studies/${encodeURIComponent(study)}/events`));
  const paint = () => {
    repainting = 0;
    if (study && loaded === wanted) connection.paint(study);
  };
  followed.addEventListener("point", () => (repainting ||= setTimeout(paint, POLL_MILLISECONDS)));
  followed.addEventListener("finished", () => {
    followed.close();
    repainting ||= setTimeout(paint, POLL_MILLISECONDS);
  });
}

/** Open the plan of a point of the study, made now if there is none yet. */
async function openPoint(index) {
  const of = study;
  try {
    const plan = await planOfPoint(of, index);
    if (of !== study || plan.id === wanted) return;
    unlisted = plan;
    choose(plan.id, true);
    refreshList();
  } catch (error) {
    if (of === study) player.panel.tellStudy({ ...player.panel.study, refusal: error.message });
  }
}

/** Leave the study: what is chosen is no point of it. */
function leaveStudy() {
  studyEvents?.close();
  [study, studyEvents] = [null, null];
  player.panel.tellStudy(null);
}

/** Draw lightly or fully, here and the next time. */
function setLight(on) {
  light = on;
  localStorage.setItem(LIGHT_KEY, String(on));
  connection.detail(on);
  showFrame();
  if (wanted) choose(wanted);
  else if (wantedScene) choosePerceived(wantedScene);
}

/** Open a plan; with `anew` somebody leaves another one, to which the browser leads back. */
function choose(plan, anew = false) {
  [wanted, wantedScene, loaded, faulty, deleted] = [plan, null, null, null, false];
  if (moment?.plan !== plan) moment = null;
  if (!moment) show(`?${planQuery()}`, anew);
  mark();
  perceived.close();
  player.close(mine() ? nameOf(mine()) : "Plan");
  wait("Opening the plan …");
  connection.load(plan);
}

/** Have the address lead to what is shown now. */
function show(address, anew) {
  if (anew && address !== location.search) history.pushState(null, "", address);
  else history.replaceState(null, "", address);
}

/** Show what the browser has gone back, or forth, to. */
function revisit() {
  const query = new URLSearchParams(location.search);
  const [plan, scene] = [query.get("plan"), query.get("scene")];
  if (plan && plan === wanted) return;
  if (query.get("study") !== study) leaveStudy();
  if (plan) {
    study ??= query.get("study");
    moment = { ...readMoment(), plan };
    choose(plan);
  } else if (scene) choosePerceived(scene);
  else leave();
}

/** Show no plan any more. */
function leave() {
  [wanted, wantedScene, loaded] = [null, null, null];
  document.getElementById("links").replaceChildren();
  perceived.close();
  leaveStudy();
  mark();
  showEmpty();
}

/** What is known of the plan that is wanted. */
function mine() {
  return plans.find(({ id }) => id === wanted) ?? (unlisted?.id === wanted ? unlisted : null);
}

/** A choice of the languages in which robots are told a plan, each a file. */
function programChoice(base) {
  const choice = element("select", { title: "A program for the robots" }, element("option", { value: "", textContent: "Program" }), ...PROGRAMS.map(([target, words]) => element("option", { value: target, textContent: words })));
  choice.setAttribute("aria-label", "A program for the robots");
  choice.onchange = async () => {
    const target = choice.value;
    choice.value = "";
    const address = `${base}/program.zip?target=${target}`;
    const answer = await fetch(address).catch(() => null);
    if (!answer?.ok) return say("There is no program", answer ? (await answer.json()).detail : "The service does not answer.");
    const content = URL.createObjectURL(await answer.blob());
    element("a", { href: content, download: `${player.description.title}-${target}.zip` }).click();
    URL.revokeObjectURL(content);
  };
  return choice;
}

/** Delete a plan, if that is meant. */
async function remove({ id, title }) {
  if (!confirm(`Delete the plan ${title}? It cannot be had back.`)) return;
  const answer = await fetch(`../v1/plans/${id}`, { method: "DELETE" }).catch(() => null);
  if (!answer?.ok) return say("Not deleted", answer ? (await answer.json()).detail : "The service does not answer.");
  history.replaceState(null, "", "./");
  leave();
  refreshList();
}

function choosePerceived(scene, anew = false) {
  [wanted, wantedScene, loaded, faulty] = [null, scene, null, null];
  leaveStudy();
  show(`?scene=${scene}`, anew);
  mark();
  perceived.close();
  player.close("Perceived scene");
  wait("Opening the scene …");
  connection.loadPerceived(scene);
}

/** Post a task and show what becomes of it, or why it is refused. */
async function post(task) {
  wait("Posting the task …");
  let answer, told;
  try {
    answer = await fetch("../v1/plans", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(task) });
    told = await answer.json();
  } catch {
    return say("No connection", "The task was not posted: the service does not answer.");
  }
  if (!answer.ok) return say(told.title, told.detail, ...(told.errors ?? []).map(({ pointer, detail }) => `${pointer}: ${detail}`));
  leaveStudy();
  unlisted = told;
  plans = [told, ...plans.filter(({ id }) => id !== told.id)];
  choose(told.id, true);
  refreshList();
}

/** Mark in the lists what is wanted. */
function mark() {
  for (const item of list.querySelectorAll('[role="option"]')) item.setAttribute("aria-selected", String(item.dataset.plan === wanted));
  for (const item of perceived.list.querySelectorAll('[role="option"]')) item.setAttribute("aria-selected", String(item.dataset.scene === wantedScene));
}

/** Title and words about a plan that cannot be shown. */
function whyNot(plan, detail) {
  if (plan?.state === "failed") return ["The job failed", plan.error?.detail ?? detail, "That is no property of the task: the service's log says what went wrong."];
  if (plan?.state === "cancelled") return ["Cancelled", "The job was cancelled before there was a plan."];
  if (deleted) return ["Deleted", `It was deleted, or never was: there is no plan ${wanted}.`];
  if (plan && !plan.done) {
    const title = startOf(plan) ? "Waiting for its start" : plan.state === "queued" ? "Waiting for its turn" : "Being planned";
    const cancel = element("button", { textContent: "Cancel", onclick: () => fetch(plan.links.cancel, { method: "POST" }).then(() => refreshList(), () => {}) });
    return [title, `${sentence(progressOf(plan))}. The plan appears here as soon as it is ready.`, cancel];
  }
  return ["Nothing to show", detail];
}

/** Show that no plan is chosen. */
function showEmpty() {
  player.close("Plans");
  if (plans.length || perceived.scenes.length) say("Choose a plan", "The list has all plans, the newest first, and finds them by name, part, kind, result and day.");
  else say("No plans yet", element("a", { href: "new", textContent: "Make a task in the editor" }), "or post one, and its plan appears in the list:", element("code", { textContent: `curl -H 'Content-Type: application/json' -d @assets/tasks/ab1.json ${location.origin}/v1/plans` }));
}

/** Say something in place of the scene: a title and words; nothing to let the scene be seen. */
function say(title, ...words) {
  const message = document.getElementById("message");
  message.className = "";
  message.replaceChildren(...(title ? [element("h3", { textContent: title })] : []), ...words.map((part) => element("p", {}, part)));
}

/** Say what is happening. */
function wait(words) {
  const spinner = element("span", { className: "spinner" });
  document.getElementById("message").className = "";
  document.getElementById("message").replaceChildren(element("p", {}, spinner, words));
}

/** What the list is asked for: all that the fields above it say. */
function listQuery() {
  const { name, kind, result, from, until } = Object.fromEntries(new FormData(filter));
  const query = new URLSearchParams({ page_size: PAGE_SIZE });
  if (name.trim()) query.set("name", name.trim());
  if (kind) query.set("kind", kind);
  if (result) query.set(...result.split("="));
  if (from) query.set("created_from", new Date(`${from}T00:00`).toISOString());
  if (until) {
    // Until the end of that day, which may have 23 hours or 25.
    const end = new Date(`${until}T00:00`);
    end.setDate(end.getDate() + 1);
    query.set("created_until", end.toISOString());
  }
  return query;
}

/** Fetch the pages of the list that are shown, and one more if somebody asks for it. */
async function refreshList(more = false) {
  try {
    const query = listQuery();
    const asked = String(query);
    const wantedPages = (asked === shownQuery ? shownPages : 1) + (more ? 1 : 0);
    const found = [];
    let token = null;
    let pages = 0;
    do {
      if (token) query.set("page_token", token);
      const answer = await fetch(`../v1/plans?${query}`);
      if (!answer.ok) break;
      const page = await answer.json();
      found.push(...page.plans);
      token = page.next_page_token;
      pages += 1;
    } while (token && pages < wantedPages);
    if (pages && asked === String(listQuery())) {
      [shownQuery, shownPages] = [asked, pages];
      document.getElementById("older").hidden = !token;
      await lookUp(found);
      showList(found);
    }
    const scenes = await fetch("../v1/scenes?page_size=20");
    if (scenes.ok) perceived.show((await scenes.json()).scenes, wantedScene, (scene) => choosePerceived(scene, true));
  } catch {
    // The connection to the service tells the watcher when the service is away.
  }
  clearTimeout(polling);
  const awaited = wanted && faulty !== wanted && (loaded !== wanted || simulating);
  polling = setTimeout(refreshList, awaited ? BUSY_MILLISECONDS : POLL_MILLISECONDS);
}

/** Ask for the plan that is wanted where it is none of those listed. */
async function lookUp(listed) {
  if (!wanted || listed.some(({ id }) => id === wanted)) return;
  const plan = wanted;
  const answer = await fetch(`../v1/plans/${encodeURIComponent(plan)}`);
  if (plan !== wanted) return;
  if (answer.ok) unlisted = await answer.json();
  else if (answer.status === 404) [unlisted, deleted] = [null, true];
}

function showList(newest) {
  const wasEmpty = !plans.length;
  plans = newest;
  const items = plans.length ? plans.flatMap(withDay) : [nothingListed()];
  const fresh = element("ul", {}, ...items);
  if (list.innerHTML !== fresh.innerHTML) {
    const focused = document.activeElement?.dataset?.plan;
    list.replaceChildren(...fresh.children);
    if (focused) list.querySelector(`[data-plan="${CSS.escape(focused)}"]`)?.focus();
  }
  if (!connection.ready) return;
  if (!wanted) {
    if (!wantedScene && wasEmpty !== !plans.length) showEmpty();
    return;
  }
  if (deleted && !mine()) {
    // What is loaded may be watched on; where its links led there is nothing any more.
    if (loaded === wanted) document.getElementById("links").replaceChildren(element("span", { textContent: "This plan was deleted." }));
    else say(...whyNot(null));
    return;
  }
  const known = mine();
  if (!known || faulty === wanted || connection.busy) return;
  if (loaded === wanted) followSimulation(known);
  else if (known.state === "succeeded" || known.verdict) choose(wanted);
  else {
    player.close(nameOf(known));
    say(...whyNot(known));
  }
}

/** Open the plan that is shown once more when its simulation is there, at the moment that is shown. */
function followSimulation(plan) {
  if (bare && !plan.done) simulating = true;
  else if (simulating) {
    simulating = false;
    if (plan.state !== "succeeded") return;
    moment = { plan: wanted, time: player.time, source: player.sourceName, camera: null };
    choose(wanted);
  }
}

function nameOf(plan) {
  return plan.external_id ?? plan.id.slice(0, 8);
}

function progressOf(plan) {
  if (plan.state === "queued") {
    const start = startOf(plan);
    if (start) return `starts ${dayWords(start).replace("Today", "today")}, ${clockTime(start)}`;
    if (!plan.queue_position) return "waiting for its start";
    const seconds = Math.round((Date.parse(plan.expected_start) - Date.now()) / 1e3);
    const begins = seconds > 0 ? `, begins in about ${seconds < 90 ? `${seconds} s` : `${Math.round(seconds / 60)} min`}` : "";
    return `waiting, ${ordinal(plan.queue_position)} in the queue${begins}`;
  }
  const done = `${Math.round(100 * plan.progress.fraction)} %`;
  if (!plan.verdict) return `${plan.state} ${done}`;
  if (plan.verdict !== "solved") return `${plan.verdict.replace("_", " ")}, changes are tried, ${done}`;
  return plan.progress.stage === "remedies" ? `failed in physics, changes are tried, ${done}` : `solved, physics follows, ${done}`;
}

/** When a job may begin, where that is yet to come. */
function startOf({ state, start_time }) {
  return state === "queued" && start_time && Date.parse(start_time) > Date.now() ? start_time : null;
}

function sentence(words) {
  return words[0].toUpperCase() + words.slice(1);
}

function ordinal(number) {
  const tail = number % 100 >= 11 && number % 100 <= 13 ? "th" : { 1: "st", 2: "nd", 3: "rd" }[number % 10] ?? "th";
  return `${number}${tail}`;
}

/** A plan of the list, under the day it was posted on where it is that day's first. */
function withDay(plan, index) {
  const item = listItem(plan);
  const day = dayWords(plan.created_at);
  if (index && day === dayWords(plans[index - 1].created_at)) return [item];
  const heading = element("li", { className: "day", textContent: day });
  heading.setAttribute("role", "presentation");
  return [heading, item];
}

function dayWords(moment) {
  const [day, today] = [new Date(moment), new Date()].map((time) => new Date(time.getFullYear(), time.getMonth(), time.getDate()));
  const ago = Math.round((today - day) / DAY_MILLISECONDS);
  return ["Today", "Yesterday"][ago] ?? day.toLocaleDateString("en-GB", { weekday: "short", day: "numeric", month: "short", year: "numeric" });
}

function nothingListed() {
  const filtered = String(listQuery()) !== `page_size=${PAGE_SIZE}`;
  const item = element("li", { className: "none", textContent: filtered ? "none that fits the filter" : "none yet" });
  item.setAttribute("role", "option");
  item.setAttribute("aria-disabled", "true");
  return item;
}

function listItem(plan) {
  const status = plan.outcome ?? plan.state;
  const fails = plan.physics === "failed";
  const words = plan.done ? `${status.replace("_", " ")}${fails ? ", failed in physics" : ""}` : progressOf(plan);
  const item = element("li", { className: plan.done ? (fails ? "failed" : status) : startOf(plan) ? "waiting" : "running", tabIndex: 0 },
    element("span", { className: "dot" }), element("b", { textContent: nameOf(plan), title: nameOf(plan) }),
    element("small", { textContent: `${words} · ${clockTime(plan.created_at)}` }),
    ...(plan.work_master ? [element("small", { textContent: `part ${plan.work_master}` })] : []),
    ...(plan.study_id ? [element("small", { textContent: "point of a study" })] : []));
  item.dataset.plan = plan.id;
  item.setAttribute("role", "option");
  item.setAttribute("aria-selected", String(plan.id === wanted));
  const open = () => {
    if (plan.id !== wanted && plan.study_id !== study) leaveStudy();
    choose(plan.id, true);
  };
  item.onclick = open;
  item.onkeydown = (event) => listKey(event, open);
  return item;
}

document.getElementById("older").onclick = () => refreshList(true);
setInterval(writeMoment, ADDRESS_MILLISECONDS);
window.addEventListener("popstate", revisit);
window.addEventListener("hashchange", () => loaded === wanted && loaded && player.visitMoment(readMoment()));
filter.oninput = () => refreshList();
filter.onsubmit = (event) => event.preventDefault();
wait("Connecting to the service …");
refreshList();
