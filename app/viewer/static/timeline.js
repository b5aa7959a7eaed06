/* The timeline: contact states, segments coloured by kind, slider, playhead. */
"use strict";

class TimelineBar {
  constructor(seek) {
    this.seek = seek;
    this.slider = document.getElementById("time");
    this.slider.oninput = () => seek(Number(this.slider.value));
    this.states = document.getElementById("states");
    new ResizeObserver(() => this.name()).observe(this.states);
  }

  /** Show the timeline of what is played: { duration, segments, marked }. */
  show(source, colours) {
    this.source = source;
    this.slider.max = source.duration || 1;
    this.slider.disabled = !source.duration;
    const share = (start, end) => `${(100 * (end - start)) / (source.duration || 1)}%`;
    this.buttons = source.segments.map((segment) => {
      const button = element("button", { title: `${segment.words}, ${segment.state || "no state"}, ${segment.hold}` });
      button.setAttribute("aria-label", `${segment.words} at ${segment.start.toFixed(1)} s`);
      button.style.background = colours[segment.kind];
      button.style.width = share(segment.start, segment.end);
      button.onclick = () => this.seek(segment.start);
      return button;
    });
    document.getElementById("segments").replaceChildren(...this.buttons);
    this.states.replaceChildren(
      ...contactStretches(source.segments).map((stretch) => {
        const words = element("div", { title: stretch.state });
        words.style.width = share(stretch.start, stretch.end);
        return words;
      }),
    );
    this.name();
    document.getElementById("marks").replaceChildren(
      ...source.marked.map(([begin, end]) => {
        const mark = element("i");
        Object.assign(mark.style, { left: share(0, begin), width: share(begin, end) });
        return mark;
      }),
    );
  }

  /** Write each contact state in the longest words there is room for. */
  name() {
    for (const place of this.states.children)
      for (const words of shorterAndShorter(place.title)) {
        place.textContent = words;
        if (place.scrollWidth <= place.clientWidth) break;
      }
  }

  now(time, segment) {
    this.slider.value = time;
    document.getElementById("playhead").style.left = `${(100 * time) / (this.source.duration || 1)}%`;
    this.buttons.forEach((button, index) => button.classList.toggle("on", index === segment));
  }

  /** Which segment runs at a time; -1 in a plan without segments. */
  segmentAt(time) {
    const after = this.source.segments.findIndex((segment) => segment.start > time + 1e-9);
    return (after < 0 ? this.source.segments.length : after) - 1;
  }
}

/** Words for a contact state: "edge 3 on table", "edge 3", "e3", nothing. */
function shorterAndShorter(state) {
  const touched = state.split(" on ")[0];
  return [state, touched, state === "no contact" ? "free" : touched.replace(/^(\w)\w* (\d+)$/, "$1$2"), ""];
}

/** Neighbouring segments of one contact state become one stretch; the lift is one of its own. */
function contactStretches(segments) {
  const stretches = [];
  for (const { kind, state: contact, start, end } of segments) {
    const state = kind === "lift" ? "lift" : contact;
    const last = stretches.at(-1);
    if (last && last.state === state) last.end = end;
    else stretches.push({ state, start, end });
  }
  return stretches;
}
