/* The live viewer: plans and perceived scenes from the service, what is drawn from a scene of one's own. */
"use strict";

const POLL_MILLISECONDS = 3000;
/** Close code (RFC 6455) of who may not be here. */
const POLICY_VIOLATION = 1008;
/** Codes (RFC 6455) with which a side closes that cannot go on: a request that makes no sense, an error of its own. */
const FAULT_CODES = [1007, 1011];

/** A scene on the service: this connection is for what we ask, one of viser's own for the scene. */
class Connection {
  constructor() {
    this.waiting = null;
    this.busy = false;
    this.queue = [];
    this.connect();
  }

  connect() {
    this.broken = false;
    this.socket = new WebSocket(new URL("watch", location.href.replace(/^http/, "ws")));
    this.socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    this.socket.onclose = (event) => this.lost(event);
  }

  /** Load a plan into the scene. */
  load(plan) {
    this.ask({ type: "open", plan });
  }

  /** Load a perceived scene. */
  loadPerceived(scene) {
    this.ask({ type: "open_perceived", scene });
  }

  /** Show a time; of the times asked for while one is on its way, only the last counts. */
  show(source, time) {
    this.waiting = { type: "time", source, time };
    this.pump();
  }

  layer(layer, visible) {
    this.ask({ type: "layer", layer, visible });
  }

  look(view) {
    this.ask({ type: "view", view });
  }

  ask(request) {
    // The new scene asks for what is wanted then.
    if (this.broken) return this.connect();
    this.queue.push(request);
    this.pump();
  }

  pump() {
    if (this.busy || !this.ready || this.socket.readyState !== WebSocket.OPEN) return;
    let request = this.queue.shift();
    if (!request) [request, this.waiting] = [this.waiting, null];
    if (!request) return;
    this.busy = true;
    this.socket.send(JSON.stringify(request));
  }

  receive(answer) {
    if (answer.type === "scene") {
      this.ready = true;
      this.onscene(new URL(answer.scene, location.href).pathname);
    } else {
      this.busy = false;
      if (answer.type === "plan") this.onplan(answer.description);
      if (answer.type === "perceived") this.onperceived(answer.description);
      if (answer.type === "refused") this.onrefused(answer);
      if (answer.type === "fault") this.onfault(answer.detail);
    }
    this.pump();
  }

  /** The service went away or was restarted: ask for a new scene until there is one. After a fault there would be
   *  the same again, so that it is told instead; and who may not have one may not ask. */
  lost(event) {
    Object.assign(this, { ready: false, busy: false, queue: [], waiting: null });
    if (event.code === POLICY_VIOLATION) return this.onlost(event.reason);
    if (FAULT_CODES.includes(event.code)) {
      this.broken = true;
      return this.onfault(event.reason || "It ended the connection and did not say why.");
    }
    this.onlost(event.reason || "The connection to the service is lost; trying again.");
    setTimeout(() => this.connect(), 1500);
  }
}

const connection = new Connection();
const player = new Player(connection);
const perceived = new Perceived(connection);
const frame = document.getElementById("scene-frame");
const list = document.getElementById("plan-list");
let wanted = new URLSearchParams(location.search).get("plan");
/* A watcher wants a plan or a perceived scene, never both. */
let wantedScene = wanted ? null : new URLSearchParams(location.search).get("scene");
let loaded = null;
/** The plan at which the service met a fault: it is shown again when somebody chooses it, not by itself. */
let faulty = null;
let plans = [];
let sceneAddress = "";

connection.onscene = (scene) => {
  // The frame connects once there is a plan in it: a scene is not to be built and sent at the same time.
  frame.removeAttribute("src");
  sceneAddress = scene;
  loaded = null;
  if (wanted) choose(wanted);
  else if (wantedScene) choosePerceived(wantedScene);
  else showEmpty();
};
player.adopt(frame, (event) => (perceived.description ? perceived : player).key(event));
connection.onplan = (description) => {
  if (description.id !== wanted) return;
  loaded = description.id;
  say();
  showFrame();
  for (const [layer, visible] of Object.entries(player.panel.visible))
    if (visible !== (layer === "forces")) connection.layer(layer, visible);
  player.open(description);
  const base = `../v1/plans/${description.id}`;
  document.getElementById("links").replaceChildren(
    element("a", { href: `${base}/recording.html`, download: `${description.title}.html`, textContent: "Recording", title: "One file that plays offline" }),
    element("a", { href: `${base}/document`, target: "_blank", textContent: "Document", title: "The plan document" }),
  );
};
connection.onperceived = (description) => {
  if (description.id !== wantedScene) return;
  say();
  showFrame();
  perceived.open(description);
};
connection.onrefused = ({ plan, scene, detail }) => {
  if (scene && scene === wantedScene) say("Nothing to show", detail);
  if (plan && plan === wanted) say(...whyNot(plans.find(({ id }) => id === plan), detail));
};
connection.onfault = (detail) => {
  faulty = wanted;
  player.play(false);
  say("A fault of the service", detail, "Choose the plan again to try once more.");
};
connection.onlost = (words) => say("No connection", words);

VIEWS.forEach((view, index) =>
  document.getElementById("views").append(
    element("button", { textContent: capitalised(view), title: `${capitalised(view)}  ${index + 1}`, onclick: () => connection.look(view) })));

function showFrame() {
  if (!frame.hasAttribute("src")) frame.src = sceneAddress;
}

function choose(plan) {
  [wanted, wantedScene, loaded, faulty] = [plan, null, null, null];
  history.replaceState(null, "", `?plan=${plan}`);
  mark();
  perceived.close();
  const known = plans.find(({ id }) => id === plan);
  player.close(known ? nameOf(known) : "Plan");
  say("Loading …");
  connection.load(plan);
}

function choosePerceived(scene) {
  [wanted, wantedScene, loaded, faulty] = [null, scene, null, null];
  history.replaceState(null, "", `?scene=${scene}`);
  mark();
  perceived.close();
  player.close("Perceived scene");
  say("Loading …");
  connection.loadPerceived(scene);
}

/** Mark in the lists what is wanted. */
function mark() {
  for (const item of list.children) item.setAttribute("aria-selected", String(item.dataset.plan === wanted));
  for (const item of perceived.list.children) item.setAttribute("aria-selected", String(item.dataset.scene === wantedScene));
}

/** Title and words about a plan that cannot be shown. */
function whyNot(plan, detail) {
  if (plan?.state === "failed") return ["The job failed", plan.error?.detail ?? detail, "That is no property of the task: the service's log says what went wrong."];
  if (plan?.state === "cancelled") return ["Cancelled", "The job was cancelled before there was a plan."];
  if (plan && !plan.done) return ["Being planned", `${progressOf(plan)}. The plan appears here as soon as it is ready.`];
  return ["Nothing to show", detail];
}

/** Show that no plan is chosen. */
function showEmpty() {
  player.close("Plans");
  if (plans.length || perceived.scenes.length) say("Choose a plan", "The list on the left has all plans, the newest first.");
  else say("No plans yet", "Post a task, and its plan appears on the left:", element("code", { textContent: `curl -H 'Content-Type: application/json' -d @assets/tasks/ab1.json ${location.origin}/v1/plans` }));
}

/** Say something in place of the scene: a title and words; nothing to let the scene be seen. */
function say(title, ...words) {
  const message = document.getElementById("message");
  message.className = "";
  message.replaceChildren(...(title ? [element("h3", { textContent: title })] : []), ...words.map((part) => element("p", {}, part)));
}

async function refreshList() {
  try {
    const answer = await fetch("../v1/plans?page_size=50");
    if (answer.ok) showList((await answer.json()).plans);
    const scenes = await fetch("../v1/scenes?page_size=20");
    if (scenes.ok) perceived.show((await scenes.json()).scenes, wantedScene, choosePerceived);
  } catch {
    // The connection to the service tells the watcher when the service is away.
  }
  setTimeout(refreshList, POLL_MILLISECONDS);
}

function showList(newest) {
  const wasEmpty = !plans.length;
  plans = newest;
  const items = plans.length ? plans.map(listItem) : [element("li", { className: "none", textContent: "none yet" })];
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
  const mine = plans.find(({ id }) => id === wanted);
  if (!mine || [loaded, faulty].includes(wanted) || connection.busy) return;
  if (mine.state === "succeeded") choose(wanted);
  else {
    player.close(nameOf(mine));
    say(...whyNot(mine));
  }
}

function nameOf(plan) {
  return plan.external_id ?? plan.id.slice(0, 8);
}

function progressOf(plan) {
  return `${plan.state} ${Math.round(100 * plan.progress.fraction)} %`;
}

function listItem(plan) {
  const status = plan.outcome ?? plan.state;
  const words = plan.done ? status.replace("_", " ") : progressOf(plan);
  const item = element("li", { className: plan.done ? status : "running", tabIndex: 0 },
    element("span", { className: "dot" }), element("b", { textContent: nameOf(plan), title: nameOf(plan) }),
    element("small", { textContent: `${words} · ${clockTime(plan.created_at)}` }));
  item.dataset.plan = plan.id;
  item.setAttribute("role", "option");
  item.setAttribute("aria-selected", String(plan.id === wanted));
  item.onclick = () => choose(plan.id);
  item.onkeydown = (event) => listKey(event, () => choose(plan.id));
  return item;
}

refreshList();
