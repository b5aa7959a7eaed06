/* A line plot on a canvas: two axes, a grid, lines that break where a value is null. */
"use strict";

class Plot {
  /**
   * @param settings  height [px], series: [{colour, width, dash}], range: (low, high) -> [low, high] of the y axis,
   *                  mark: colour of stretches that stand out
   * @param data      [x, y of each series, …]; x rises
   * @param marked    [[from, to], …]: stretches of the x axis to stand out
   * @param box       element to fill
   */
  constructor(settings, data, marked, box) {
    Object.assign(this, { settings, data, marked });
    this.edges = { left: 40, right: 10, top: 6, bottom: 22 };
    this.canvas = document.createElement("canvas");
    this.over = document.createElement("div");
    this.over.className = "plot-over";
    const frame = document.createElement("div");
    frame.className = "plot";
    frame.append(this.canvas, this.over);
    box.append(frame);
    const values = data.slice(1).flat().filter((value) => value !== null);
    const extremes = values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
    this.y = settings.range(...(values.length ? extremes : [null, null]));
    this.x = [data[0][0], data[0].at(-1)];
    this.setSize({ width: box.clientWidth || 300, height: settings.height });
  }

  /** Show another stretch of the x axis. */
  setRange(low, high) {
    if (this.x[0] === low && this.x[1] === high) return;
    this.x = [low, high];
    this.draw();
  }

  setSize({ width, height }) {
    const { left, right, top, bottom } = this.edges;
    Object.assign(this, { width: Math.max(1, width - left - right), height: Math.max(1, height - top - bottom) });
    const pixels = window.devicePixelRatio || 1;
    this.canvas.width = width * pixels;
    this.canvas.height = height * pixels;
    Object.assign(this.canvas.style, { width: `${width}px`, height: `${height}px` });
    Object.assign(this.over.style, {
      left: `${left}px`, top: `${top}px`, width: `${this.width}px`, height: `${this.height}px`,
    });
    this.context = this.canvas.getContext("2d");
    this.context.setTransform(pixels, 0, 0, pixels, left * pixels, top * pixels);
    this.draw();
  }

  /** Pixels from the left end of the x axis, or from the top of the y axis. */
  valToPos(value, axis) {
    const [low, high] = this[axis];
    const part = (value - low) / (high - low || 1);
    return axis === "x" ? part * this.width : (1 - part) * this.height;
  }

  /** The x value at so many pixels from the left end of the axis. */
  posToVal(pixels) {
    return this.x[0] + (pixels / this.width) * (this.x[1] - this.x[0]);
  }

  draw() {
    const { context } = this;
    context.clearRect(-this.edges.left, -this.edges.top, this.canvas.width, this.canvas.height);
    context.font = "11px system-ui, sans-serif";
    context.lineWidth = 1;
    context.strokeStyle = resolved("var(--grid)");
    context.fillStyle = resolved("var(--soft)");
    Object.assign(context, { textAlign: "center", textBaseline: "top" });
    for (const tick of ticks(...this.x, this.width / 60)) {
      const x = Math.round(this.valToPos(tick, "x")) + 0.5;
      stroke(context, [[x, 0], [x, this.height]]);
      context.fillText(`${tick} s`, x, this.height + 5);
    }
    Object.assign(context, { textAlign: "right", textBaseline: "middle" });
    for (const tick of ticks(...this.y, this.height / 26)) {
      const y = Math.round(this.valToPos(tick, "y")) + 0.5;
      stroke(context, [[0, y], [this.width, y]]);
      context.fillText(`${tick}`, -6, y);
    }
    context.save();
    context.beginPath();
    context.rect(0, -this.edges.top, this.width, this.height + 2 * this.edges.top);
    context.clip();
    context.fillStyle = this.settings.mark;
    for (const [from, to] of this.marked) {
      const left = this.valToPos(from, "x");
      context.fillRect(left, 0, Math.max(2, this.valToPos(to, "x") - left), this.height);
    }
    this.settings.series.forEach((style, index) => this.line(style, this.data[index + 1]));
    context.restore();
  }

  line(style, values) {
    const { context } = this;
    Object.assign(context, { strokeStyle: resolved(style.colour), lineWidth: style.width, lineJoin: "round" });
    context.setLineDash(style.dash ?? []);
    let run = [];
    values.forEach((value, index) => {
      if (value === null) {
        stroke(context, run);
        run = [];
      } else {
        run.push([this.valToPos(this.data[0][index], "x"), this.valToPos(value, "y")]);
      }
    });
    stroke(context, run);
    context.setLineDash([]);
  }
}

/** A colour as a canvas takes it: of one that the style names, what it is now. */
function resolved(colour) {
  const name = /^var\((.+)\)$/.exec(colour)?.[1];
  return name ? getComputedStyle(document.documentElement).getPropertyValue(name).trim() : colour;
}

function stroke(context, points) {
  context.beginPath();
  points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
}

/** Round numbers within [low, high], about so many. */
function ticks(low, high, about) {
  const rough = (high - low) / Math.max(1, about);
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough) ?? 1;
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
    found.push(Number((k * step).toFixed(digits)));
  }
  return found;
}
