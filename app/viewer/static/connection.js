/* The connection of a page to a scene on the service that shows plans and perceived scenes. */
"use strict";

/** Close code (RFC 6455) of who may not be here. */
const POLICY_VIOLATION = 1008;
/** Codes (RFC 6455) with which a side closes that cannot go on: a request that makes no sense, an error of its own. */
const FAULT_CODES = [1007, 1011];

/** Say why a connection to the service has ended, whether by a fault, and whether to ask for another. */
async function lossOf({ code, reason }) {
  if (code === POLICY_VIOLATION) return { words: reason, fault: false, again: false };
  // After a fault there would be the same again, so that it is told instead.
  if (FAULT_CODES.includes(code)) return { words: reason || "It ended the connection and did not say why.", fault: true, again: false };
  if (await isSignedOut()) return { words: "You are signed out: load this page again to sign in.", fault: false, again: false };
  return { words: reason || "The connection to the service is lost; trying again.", fault: false, again: true };
}

/** Whether the service sends who asks for this page to where a key is shown; a socket is not told that. */
async function isSignedOut() {
  try {
    const signal = AbortSignal.timeout(1500);
    const answer = await fetch(location.href, { method: "HEAD", headers: { Accept: "text/html" }, redirect: "manual", signal });
    return answer.type === "opaqueredirect";
  } catch {
    return false;
  }
}

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

  /** Draw so much from the next plan on. */
  detail(light) {
    this.ask({ type: "detail", light });
  }

  /** Paint the map of a study onto the plate of the plan that is shown. */
  paint(study) {
    if (!this.queue.some(({ type }) => type === "paint")) this.ask({ type: "paint", study });
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
    } else if (answer.type === "point") {
      // Nobody asked for it: somebody clicked on a tile in the scene.
      this.onpoint(answer.study, answer.point);
    } else {
      this.busy = false;
      if (answer.type === "plan") this.onplan(answer.description, answer.study);
      if (answer.type === "perceived") this.onperceived(answer.description);
      if (answer.type === "painted") this.onpainted(answer);
      if (answer.type === "camera") this.oncamera(answer.camera);
      if (answer.type === "refused") this.onrefused(answer);
      if (answer.type === "fault") this.onfault(answer.detail);
    }
    this.pump();
  }

  /** The service went away or was restarted: ask for a new scene until there is one; who may not have one may not ask. */
  async lost(event) {
    Object.assign(this, { ready: false, busy: false, queue: [], waiting: null });
    const { words, fault, again } = await lossOf(event);
    // Who asks for something then is answered by a new connection, or told again why there is none.
    this.broken = !again;
    if (fault) this.onfault(words);
    else this.onlost(words);
    if (again) setTimeout(() => this.connect(), 1500);
  }
}
