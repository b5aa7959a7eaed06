/* The live viewer: plans from the service, the scene from a room of one's own. */
"use strict";

const VIEWS = ["overview", "front", "side", "top", "close"];
const POLL_MILLISECONDS = 3000;

/** A room on the service: one connection for what we ask, one (viser's own) for the scene. */
class Room {
  constructor() {
    this.waiting = null;
    this.busy = false;
    this.queue = [];
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(new URL("watch", location.href.replace(/^http/, "ws")));
    this.socket.onmessage = (event) => this.receive(JSON.parse(event.data));
    this.socket.onclose = (event) => this.lost(event);
  }

  /** Load a plan into the room. */
  load(plan) {
    this.plan = plan;
    this.ask({ type: "open", plan });
  }

  /** Show a time; of the times asked for while one is on its way, only the last counts. */
  show(time) {
    this.waiting = { type: "time", time };
    this.pump();
  }

  layer(layer, visible) {
    this.ask({ type: "layer", layer, visible });
  }

  look(view) {
    this.ask({ type: "view", view });
  }

  ask(request) {
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
    if (answer.type === "room") {
      this.ready = true;
      this.onroom(new URL(answer.scene, location.href).pathname);
    } else {
      this.busy = false;
      if (answer.type === "story") this.onstory(answer.story);
      if (answer.type === "refused") this.onrefused(answer);
    }
    this.pump();
  }

  /** The service went away or was restarted: ask for a new room until there is one. */
  lost(event) {
    Object.assign(this, { ready: false, busy: false, queue: [], waiting: null });
    this.onlost(event.reason || "The connection to the service is lost; trying again.");
    setTimeout(() => this.connect(), 1500);
  }
}

const room = new Room();
const player = new Player(room);
const frame = document.getElementById("scene-frame");
const list = document.getElementById("plan-list");
let wanted = new URLSearchParams(location.search).get("plan");
let loaded = null;
let sceneAddress = "";

room.onroom = (scene) => {
  // The frame connects once there is a plan in the room: a scene is not to be built and sent at the same time.
  frame.removeAttribute("src");
  sceneAddress = scene;
  loaded = null;
  if (wanted) choose(wanted);
  else say("Choose a plan on the left.");
};
player.adopt(frame);
room.onstory = (story) => {
  if (story.id !== wanted) return;
  loaded = story.id;
  say("");
  if (!frame.hasAttribute("src")) frame.src = sceneAddress;
  for (const [layer, visible] of Object.entries(player.panel.visible))
    if (visible !== (layer === "forces")) room.layer(layer, visible);
  player.open(story);
  const base = `../v1/plans/${story.id}`;
  document.getElementById("links").replaceChildren(
    element("a", { href: `${base}/recording.html`, download: `${story.title}.html`, textContent: "Recording", title: "One file that plays offline" }),
    element("a", { href: `${base}/document`, target: "_blank", textContent: "Document", title: "The plan document" }),
  );
};
room.onrefused = ({ plan, detail }) => plan === wanted && say(detail);
room.onlost = (words) => say(words);

for (const view of VIEWS)
  document.getElementById("views").append(
    element("button", { textContent: view[0].toUpperCase() + view.slice(1), onclick: () => room.look(view) }));

function choose(plan) {
  wanted = plan;
  history.replaceState(null, "", `?plan=${plan}`);
  for (const item of list.children) item.setAttribute("aria-selected", String(item.dataset.plan === plan));
  say("Loading the plan …");
  room.load(plan);
}

function say(words) {
  const message = document.getElementById("message");
  message.className = "";
  message.replaceChildren(...(words ? [words] : []));
}

async function refreshList() {
  try {
    const answer = await fetch("../v1/plans?page_size=50");
    if (answer.ok) showList((await answer.json()).plans);
  } catch {
    // The connection to the room tells the watcher when the service is away.
  }
  setTimeout(refreshList, POLL_MILLISECONDS);
}

function showList(plans) {
  const items = plans.map((plan) => listItem(plan));
  if (!items.length) items.push(element("li", { className: "none", textContent: "No plans yet. Post a task to /v1/plans." }));
  if (list.innerHTML !== element("ul", {}, ...items).innerHTML) {
    const focused = document.activeElement?.dataset?.plan;
    list.replaceChildren(...plans.map((plan) => listItem(plan)), ...(plans.length ? [] : items));
    if (focused) list.querySelector(`[data-plan="${CSS.escape(focused)}"]`)?.focus();
  }
  const mine = plans.find((plan) => plan.id === wanted);
  if (mine?.state === "succeeded" && loaded !== wanted && room.ready && !room.busy) choose(wanted);
}

function listItem(plan) {
  const status = plan.outcome ?? plan.state;
  const words = plan.done ? status.replace("_", " ") : `${plan.state} ${Math.round(100 * plan.progress.fraction)} %`;
  const when = new Date(plan.created_at).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });
  const item = element("li", { className: plan.done ? status : "running", tabIndex: 0 },
    element("span", { className: "dot" }), element("b", { textContent: plan.external_id ?? plan.id.slice(0, 8) }),
    element("small", { textContent: `${words} · ${when}` }));
  item.dataset.plan = plan.id;
  item.setAttribute("role", "option");
  item.setAttribute("aria-selected", String(plan.id === wanted));
  item.onclick = () => choose(plan.id);
  item.onkeydown = (event) => event.key === "Enter" && choose(plan.id);
  return item;
}

refreshList();
