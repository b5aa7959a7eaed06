/* Curves under the scene: plots that share the page's time. */
"use strict";

/** A simulation's samples begin and end some hundredths of a second inside its time [s]. */
const NEAR = 0.1;

class Charts {
  /** @param root element to fill  @param colours meaning -> colour  @param seek called with a time in seconds */
  constructor(root, colours, seek) {
    Object.assign(this, { root, colours, seek, charts: [], time: 0 });
    new ResizeObserver(() => this.resize()).observe(root);
    DARK.addEventListener("change", () => this.charts.forEach(({ plot }) => plot.draw()));
  }

  /** Show the curves of what is played: { charts, pages }. */
  show({ charts, pages }) {
    this.root.replaceChildren();
    this.pages = pages;
    this.charts = charts.map((chart) => this.add(chart));
    this.resize();
  }

  add(chart) {
    const title = element("h3", {}, chart.title, element("small", { textContent: `[${chart.unit}]` }));
    const legend = element("ul");
    const values = chart.series.map((line) => {
      const value = element("b");
      // As wide as its longest reading: a legend that wraps anew while it plays would move the scene.
      value.style.minWidth = `${Math.max(...line.values.map((each) => (each === null ? 0 : readable(each).length)))}ch`;
      const mark = element("i", { className: line.dashed ? "dashed" : "" });
      mark.style.borderColor = this.colours[line.colour];
      legend.append(element("li", {}, mark, line.name, value));
      return value;
    });
    const box = element("div");
    this.root.append(element("div", { className: "chart" }, title, legend, box));
    const plot = new Plot(this.settings(chart), [chart.time, ...chart.series.map((line) => line.values)], chart.marked, box);
    const line = element("div", { className: "now-line" });
    plot.over.append(line);
    const seek = (event) => this.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left));
    plot.over.addEventListener("pointerdown", (event) => {
      plot.over.setPointerCapture(event.pointerId);
      seek(event);
    });
    plot.over.addEventListener("pointermove", (event) => {
      if (event.buttons === 1) seek(event);
      this.under(plot, chart, event);
    });
    plot.over.addEventListener("pointerleave", () => this.root.querySelectorAll(".under, .under-line").forEach((each) => each.remove()));
    return { chart, plot, line, values, box };
  }

  settings(chart) {
    return {
      height: 132,
      range: paddedRange,
      mark: `${this.colours.limit}38`,
      series: chart.series.map((line) => ({
        colour: this.colours[line.colour],
        width: line.dashed ? 1.4 : 1.9,
        dash: line.dashed ? [6, 4] : [],
      })),
    };
  }

  /** Tell the values under the cursor. */
  under(plot, chart, { clientX, pointerType }) {
    this.root.querySelectorAll(".under, .under-line").forEach((each) => each.remove());
    if (pointerType === "touch") return;
    const x = clientX - plot.over.getBoundingClientRect().left;
    const time = plot.posToVal(x);
    const rows = chart.series.map((series) => {
      const value = valueAt(chart.time, series.values, time);
      const mark = element("i");
      mark.style.borderColor = this.colours[series.colour];
      return element("span", {}, mark, `${series.name} ${value === null ? "–" : `${readable(value)} ${chart.unit}`}`);
    });
    const box = element("div", { className: "under" }, element("b", { textContent: `${time.toFixed(2)} s` }), ...rows);
    const line = element("div", { className: "under-line" });
    plot.over.append(box, line);
    line.style.left = `${x}px`;
    // On the side that has more room.
    box.style.left = `${x < plot.width / 2 ? x + 12 : x - 12 - box.offsetWidth}px`;
  }

  resize() {
    const height = window.innerHeight < 720 ? 104 : window.innerHeight > 940 ? 172 : 132;
    for (const { plot, box } of this.charts) plot.setSize({ width: box.clientWidth, height });
    this.now(this.time);
  }

  /** Turn to the page of a time, move the line that says "now" there, and write its values. */
  now(time) {
    this.time = time;
    const page = this.pages?.findLast(([begin]) => begin <= time) ?? [0, 1];
    for (const { chart, plot, line, values } of this.charts) {
      plot.setRange(...page);
      const inside = time >= chart.time[0] - NEAR && time <= chart.time.at(-1) + NEAR;
      line.hidden = !inside;
      line.style.left = `${plot.valToPos(time, "x")}px`;
      chart.series.forEach((series, index) => {
        const value = inside ? valueAt(chart.time, series.values, time) : null;
        values[index].textContent = value === null ? "" : readable(value);
      });
    }
  }
}

function paddedRange(low, high) {
  if (low === null || high === null || (low === 0 && high === 0)) return [0, 1];
  const room = 0.08 * Math.max(high - low, 1e-6);
  return [low >= 0 ? 0 : low - room, high + room];
}

/** The value of a curve at a time; of two at one time, the later one. */
function valueAt(times, values, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  const next = Math.min(low + 1, times.length - 1);
  const [a, b] = [values[low], values[next]];
  if (a === null || b === null) return a;
  const step = times[next] - times[low];
  return step > 0 ? a + ((b - a) * Math.min(Math.max(time - times[low], 0), step)) / step : a;
}

/** A value with as many digits as can be told apart in a curve. */
function readable(value) {
  const size = Math.abs(value);
  return value.toFixed(size < 5e-4 || size >= 1 ? 1 : size >= 0.1 ? 2 : 3);
}
