/* The recording: the scene is viser's player, which this page's clock drives. */
"use strict";

/** After so long without another wish a step back is made once more. */
const QUIET_MILLISECONDS = 400;

/** Drives the player inside the frame through the field that shows its time. */
class RecordedScene {
  constructor(frame) {
    this.frame = frame;
    this.wanted = this.shown = 0;
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
  }
}

document.body.classList.add("recorded");
const frame = document.getElementById("scene-frame");
const scene = new RecordedScene(frame);
const player = new Player(scene);
// Only the picture is wanted of viser's player: the bar at the bottom is this page's.
adoptFrame(frame, (event) => player.key(event));
const waiting = setInterval(() => {
  if (!frame.contentDocument?.querySelector("input")) return;
  clearInterval(waiting);
  player.refresh();
}, 50);
/** What viser's page reads first of how it is to look. */
const APPEARANCE = /(__VISER_EMBED_CONFIG__=\{darkMode:)\w+/;
frame.srcdoc = RECORDED.scene.replace(APPEARANCE, `$1${DARK.matches}`);
player.open(RECORDED.description);
