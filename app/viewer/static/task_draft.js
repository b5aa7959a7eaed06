/* A task as far as somebody has come with it: members by JSON pointer, undo and redo. No page, no service. */
"use strict";

/** Changes of one member that follow each other faster than this are one step to undo. */
const ONE_STEP_MILLISECONDS = 900;

/** Steps of a JSON pointer (RFC 6901). */
function steps(pointer) {
  return pointer.split("/").slice(1).map((step) => step.replaceAll("~1", "/").replaceAll("~0", "~"));
}

/** Whether a pointer is another one, or leads into it. */
function within(pointer, outer) {
  return pointer === outer || pointer.startsWith(`${outer}/`);
}

class TaskDraft {
  /** @param onchange called after every change */
  constructor(onchange) {
    Object.assign(this, { onchange, past: [], future: [], last: "", at: 0 });
    this.task = {};
  }

  /** Begin with a task; where there was another one, undo leads back to it. */
  begin(task) {
    if (Object.keys(this.task).length) this.step("");
    this.task = structuredClone(task);
    this.onchange();
  }

  get(pointer) {
    return steps(pointer).reduce((value, step) => value?.[step], this.task);
  }

  /** Set a member; of objects that are missing on the way there, new ones are made. */
  set(pointer, value) {
    if (JSON.stringify(this.get(pointer)) === JSON.stringify(value)) return;
    this.step(pointer);
    const path = steps(pointer);
    const last = path.pop();
    let holder = this.task;
    for (const step of path) holder = holder[step] ??= {};
    holder[last] = value;
    this.onchange();
  }

  /** Take a member away: its default holds again. Of an array, those behind it move up. */
  remove(pointer) {
    if (this.get(pointer) === undefined) return;
    this.step("");
    const path = steps(pointer);
    const last = path.pop();
    const holder = path.reduce((value, step) => value[step], this.task);
    if (Array.isArray(holder)) holder.splice(Number(last), 1);
    else delete holder[last];
    this.onchange();
  }

  /** Change several members in one step to undo. */
  together(change) {
    this.step("");
    change(this.task);
    this.onchange();
  }

  undo() {
    this.turn(this.past, this.future);
  }

  redo() {
    this.turn(this.future, this.past);
  }

  turn(from, to) {
    if (!from.length) return;
    to.push(JSON.stringify(this.task));
    this.task = JSON.parse(from.pop());
    this.last = "";
    this.onchange();
  }

  /** Remember what is there before a change. */
  step(pointer) {
    const now = performance.now();
    const goesOn = pointer && pointer === this.last && now - this.at < ONE_STEP_MILLISECONDS;
    [this.last, this.at] = [pointer, now];
    if (goesOn) return;
    this.past.push(JSON.stringify(this.task));
    this.future = [];
  }

  /** The step that runs is over: what follows is another one to undo. */
  rest() {
    this.last = "";
  }
}

/** The turn about the vertical of a pose [rad]: of its x axis, or of y where x is upright. */
function yawOf([, , , w, x, y, z]) {
  if (Math.abs(2 * (x * z - w * y)) < Math.cos(Math.PI / 6)) return Math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z));
  return Math.atan2(-2 * (x * y - w * z), 1 - 2 * (x * x + z * z));
}

/** A pose turned about the vertical to a yaw [rad]. */
function withYaw(pose, yaw) {
  const half = (yaw - yawOf(pose)) / 2;
  return turned(pose, [Math.cos(half), 0, 0, Math.sin(half)]);
}

/** A pose turned by a quaternion in the world, in its place. */
function turned([px, py, pz, ...r], [w, x, y, z]) {
  const q = [
    w * r[0] - x * r[1] - y * r[2] - z * r[3], w * r[1] + x * r[0] + y * r[3] - z * r[2],
    w * r[2] - x * r[3] + y * r[0] + z * r[1], w * r[3] + x * r[2] - y * r[1] + z * r[0],
  ];
  const size = Math.hypot(...q) * (q[0] < 0 ? -1 : 1);
  return [px, py, pz, ...q.map((value) => rounded(value / size))];
}

/** A number without digits that nobody means. */
function rounded(value, digits = 9) {
  return Number(value.toFixed(digits)) + 0;
}
