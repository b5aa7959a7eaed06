/* The recording: the scene is viser's player, which this page's clock drives. */
"use strict";

/** Drives the player inside the frame through the field that shows its time. */
class RecordedScene {
  constructor(frame) {
    this.frame = frame;
  }

  show(source, time) {
    const wanted = RECORDED.begins[source] + time;
    const field = this.frame.contentDocument?.querySelector("input");
    if (!field) return;
    // The field shows tenths and ignores what it shows already: a little more is never what it shows.
    const write = Object.getOwnPropertyDescriptor(this.frame.contentWindow.HTMLInputElement.prototype, "value").set;
    write.call(field, (wanted + 0.00013).toFixed(5));
    field.dispatchEvent(new this.frame.contentWindow.Event("input", { bubbles: true }));
  }
}

document.body.classList.add("recorded");
const frame = document.getElementById("scene-frame");
const scene = new RecordedScene(frame);
const player = new Player(scene);
// Only the picture is wanted of viser's player: the bar at the bottom is this page's.
player.adopt(frame);
const waiting = setInterval(() => {
  if (!frame.contentDocument?.querySelector("input")) return;
  clearInterval(waiting);
  player.refresh();
}, 50);
frame.srcdoc = RECORDED.scene;
player.open(RECORDED.story);
