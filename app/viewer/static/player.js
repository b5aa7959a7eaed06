/* The page's clock, and everything that follows it: scene, timeline, curves, words. */
"use strict";

/* Panels, bars and notes of viser's page, in all of its layouts. */
const AROUND_THE_SCENE = ".mantine-Paper-root, [data-floating-window], .mantine-Notifications-root { display: none !important; }";
const SPEEDS = [0.25, 0.5, 1, 2, 4];

class Player {
  /** @param source what draws the scene: show(time), and for a live scene layer(name, visible) */
  constructor(source) {
    this.source = source;
    this.time = 0;
    this.playing = false;
    this.score = new Score((time) => this.seek(time));
    this.panel = new Panel(source.layer ? (name, visible) => source.layer(name, visible) : null);
    document.getElementById("play").onclick = () => this.play(!this.playing);
    document.getElementById("previous").onclick = () => this.jump(-1);
    document.getElementById("next").onclick = () => this.jump(1);
    window.addEventListener("keydown", (event) => this.key(event), true);
  }

  /** Show a plan from its start. */
  open(story) {
    this.story = story;
    this.time = 0;
    this.play(false);
    const colours = {};
    for (const group of Object.values(story.legend))
      for (const [name, { colour }] of Object.entries(group)) colours[name] = colour;
    this.colours = colours;
    this.charts ??= new Charts(document.getElementById("charts"), colours, (time) => this.seek(time));
    this.charts.show(story);
    this.score.show(story, colours);
    this.panel.show(story);
    this.headline();
    this.refresh();
  }

  headline() {
    const story = this.story;
    document.title = `${story.title} · Liftwright`;
    document.getElementById("title").textContent = story.title;
    document.getElementById("subtitle").textContent = story.subtitle;
    const badge = document.getElementById("outcome");
    Object.assign(badge, { hidden: false, className: `badge ${story.outcome}`, textContent: story.outcome_words });
    document.getElementById("highlights").replaceChildren(
      ...story.highlights.map(([label, value]) =>
        element("div", {}, element("dt", { textContent: label }), element("dd", { textContent: value }))),
    );
    const message = document.getElementById("message");
    message.className = "low";
    message.replaceChildren(...(story.outcome === "solved" ? [] : explanation(story)));
  }

  play(on) {
    if (on && !this.story?.duration) return;
    if (on && this.time >= this.story.duration - 1e-6) this.time = 0;
    this.playing = on;
    const button = document.getElementById("play");
    button.classList.toggle("on", on);
    button.setAttribute("aria-label", on ? "Pause" : "Play");
    if (!on) return;
    let last = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      this.time = Math.min(this.time + ((now - last) / 1000) * Number(document.getElementById("speed").value), this.story.duration);
      last = now;
      this.refresh();
      if (this.time >= this.story.duration) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  seek(time) {
    if (!this.story) return;
    this.time = Math.min(Math.max(time, 0), this.story.duration);
    this.refresh();
  }

  /** Go to a neighbouring segment's start; back first goes to the start of the one that runs. */
  jump(direction) {
    if (!this.story?.segments.length) return;
    const here = this.score.segmentAt(this.time);
    const into = this.time - this.story.segments[here].start;
    const target = direction < 0 && into > 0.3 ? here : here + direction;
    if (target >= this.story.segments.length) this.seek(this.story.duration);
    else this.seek(this.story.segments[Math.max(target, 0)].start);
  }

  refresh() {
    const { story, time } = this;
    this.source.show(time);
    const segment = this.score.segmentAt(time);
    this.score.now(time, segment);
    this.charts.now(time);
    document.getElementById("clock").replaceChildren(
      `${time.toFixed(2)} s`, element("small", { textContent: ` / ${story.duration.toFixed(1)}` }));
    if (segment !== this.shownSegment || story !== this.shownStory) this.caption(segment);
  }

  caption(segment) {
    this.shownSegment = segment;
    this.shownStory = this.story;
    const now = document.getElementById("now");
    if (segment < 0) return now.replaceChildren();
    const { kind, words, state, hold } = this.story.segments[segment];
    const mark = element("i");
    mark.style.background = this.colours[kind];
    now.replaceChildren(element("b", {}, mark, words), element("span", { textContent: state }), element("span", { textContent: hold }));
  }

  /** Keys of the player; those it takes do not reach the scene's camera. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.story) return;
    if (event.target.tagName === "SELECT" && !["[", "]"].includes(event.key)) return;
    const step = event.shiftKey ? 2 : 0.2;
    const speed = document.getElementById("speed");
    const faster = (by) => (speed.value = SPEEDS[Math.min(Math.max(SPEEDS.indexOf(Number(speed.value)) + by, 0), SPEEDS.length - 1)]);
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.seek(this.time - step),
      ArrowRight: () => this.seek(this.time + step),
      Home: () => this.seek(0),
      End: () => this.seek(this.story.duration),
      "[": () => this.jump(-1),
      "]": () => this.jump(1),
      "+": () => faster(1),
      "-": () => faster(-1),
    };
    if (this.panel.setLayer)
      for (const [name, , key] of LAYERS) actions[key.toLowerCase()] = () => this.panel.toggle(name);
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action || (event.target.role === "tab" && event.key === " ")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    action();
  }

  /** Take the keys that are pressed while the scene has the focus, and hide what viser's page adds around its scene.
   *  That page writes itself anew while it loads, so this looks again and again whether it still holds. */
  adopt(frame) {
    const look = () => {
      const page = frame.contentDocument;
      if (!page?.head || page.getElementById("liftwright-style")) return;
      page.head.append(Object.assign(page.createElement("style"), { id: "liftwright-style", textContent: AROUND_THE_SCENE }));
      page.addEventListener("keydown", (event) => this.key(event), true);
    };
    frame.addEventListener("load", look);
    setInterval(look, 250);
  }
}

function explanation(story) {
  const causes = story.causes.map(({ reason, numbers }) =>
    element("li", {}, reason, ...(numbers ? [element("em", { textContent: numbers })] : [])));
  return [element("h3", { textContent: `${story.outcome_words[0].toUpperCase()}${story.outcome_words.slice(1)}` }),
    element("p", { textContent: story.summary }), element("ul", {}, ...causes)];
}
