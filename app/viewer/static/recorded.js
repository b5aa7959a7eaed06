/* The recording: the scene is viser's player, which this page's clock drives. */
"use strict";

/** After so long without another wish a step back is made once more. */
const QUIET_MILLISECONDS = 400;

/** Drives the player inside the frame: its time through the field that shows it, its nodes and camera by the messages that
 *  it plays. All layers are recorded; which of its nodes are seen with which layers, the gates tell. */
class RecordedScene {
  constructor(frame) {
    this.frame = frame;
    this.wanted = this.shown = 0;
    this.layers = new Set(FIRST_LAYERS);
  }

  /** Show or hide a layer. */
  layer(name, visible) {
    if (visible) this.layers.add(name);
    else this.layers.delete(name);
    this.hide();
  }

  /** Move the camera to one of its places; some are relative to the body that is moved. */
  look(name) {
    const { position, target, from_body: fromBody } = RECORDED.views[name];
    const segment = player.timeline.segmentAt(player.time);
    const at = fromBody ? this.placeOf(RECORDED.moved[segment] ?? RECORDED.moved[0]) : [0, 0, 0];
    const from = (offset) => offset.map((value, axis) => value + at[axis]);
    this.play([
      { type: "SetCameraPositionMessage", position: from(position), initial: false },
      { type: "SetCameraLookAtMessage", look_at: from(target), initial: false },
    ]);
  }

  /** Where a node is in the world [m]. */
  placeOf(node) {
    return this.viewer?.nodePoseData[node]?.position ?? [0, 0, 0];
  }

  /** Hide what no layer shows. */
  hide() {
    const isSeen = ({ shown_with: all, hidden_with: none }) => all.every((name) => this.layers.has(name)) && !none.some((name) => this.layers.has(name));
    this.play(RECORDED.gates.map((gate) => ({ type: "SetSceneNodeVisibilityMessage", name: gate.node, visible: isSeen(gate), owner: "" })));
  }

  /** What viser's page keeps of its scene; nothing while it loads. */
  get viewer() {
    return this.frame.contentWindow?.__viserMutable;
  }

  /** Have viser's page do what a server, or its recording, would have it do. */
  play(messages) {
    if (!this.viewer) return;
    this.viewer.messageQueue.push(...messages);
    this.viewer.requestRender();
  }

  show(source, time) {
    this.wanted = RECORDED.begins[source] + time;
    // One wish a picture: of several, the last counts.
    this.next ??= requestAnimationFrame(() => {
      this.next = null;
      // While the player still works on an earlier wish, its messages can come after those of a step back.
      this.back ||= this.wanted < this.shown;
      this.shown = this.wanted;
      this.write(this.wanted + 0.00013);
      clearTimeout(this.quiet);
      this.quiet = setTimeout(() => this.settle(), QUIET_MILLISECONDS);
    });
  }

  settle() {
    if (this.back) this.write(this.wanted + 0.00007);
    this.back = false;
  }

  write(wanted) {
    const field = this.frame.contentDocument?.querySelector("input");
    if (!field) return;
    // The field shows tenths and ignores what it shows already: a little more is never what it shows.
    const write = Object.getOwnPropertyDescriptor(this.frame.contentWindow.HTMLInputElement.prototype, "value").set;
    write.call(field, wanted.toFixed(5));
    field.dispatchEvent(new this.frame.contentWindow.Event("input", { bubbles: true }));
    // A step back shows all that was recorded again.
    this.hide();
  }
}

document.body.classList.add("recorded");
const frame = document.getElementById("scene-frame");
const scene = new RecordedScene(frame);
const player = new Player(scene);
addCameraButtons(scene);
// Only the picture is wanted of viser's player: the bar at the bottom is this page's.
adoptFrame(frame, (event) => player.key(event));
const waiting = setInterval(() => {
  if (!frame.contentDocument?.querySelector("input") || !scene.viewer) return;
  clearInterval(waiting);
  player.refresh();
}, 50);
/** What viser's page reads first of how it is to look. */
const APPEARANCE = /(__VISER_EMBED_CONFIG__=\{darkMode:)\w+/;
frame.srcdoc = RECORDED.page.replace(APPEARANCE, `$1${DARK.matches}`);
player.open(RECORDED.description);
player.visitMoment(readMoment());
window.addEventListener("hashchange", () => player.visitMoment(readMoment()));
setInterval(() => {
  if (player.playing) return;
  const address = player.moment.join("&");
  if (location.hash.slice(1) !== address) history.replaceState(null, "", address ? `#${address}` : location.pathname + location.search);
}, ADDRESS_MILLISECONDS);
