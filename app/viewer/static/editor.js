/* The editor: a task in a scene that is dragged in, its values beside it, and what the service would say of it. */
"use strict";

const POLL_MILLISECONDS = 400;
const CHECK_MILLISECONDS = 60;
/** So long after no answer the service is asked again. */
const AWAY_MILLISECONDS = 1500;
/** So long after the last change a task is planned by itself, where that is wanted. */
const REST_MILLISECONDS = 1500;
const MOVE = 0.01, FINE_MOVE = 0.001, TURN = Math.PI / 12, FINE_TURN = Math.PI / 180;
/** Along the world's x and y, as seen from the front, where the camera is first. */
const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
const LIGHT = drawsLightly();
const byId = (id) => document.getElementById(id);

/** The scene on the service: draws the draft, and tells what is done in it. */
class SceneConnection {
  constructor(handlers) {
    this.handlers = handlers;
    this.connect();
  }

  connect() {
    Object.assign(this, { ready: false, drawing: false, waiting: null, later: [], nudges: 0, nudged: 0 });
    this.socket = new WebSocket(new URL("edit", location.href.replace(/^http/, "ws")));
    this.socket.onmessage = ({ data }) => this.receive(JSON.parse(data));
    this.socket.onclose = (event) => this.lost(event);
  }

  send(request) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request));
  }

  /** Draw; of drafts that come while one is being drawn, only the last counts. */
  draw(request) {
    if (!this.ready || this.drawing) {
      this.waiting = request;
      return;
    }
    this.drawing = true;
    this.send({ type: "draw", ...request });
    for (const each of this.later.splice(0)) this.sendNudge(each);
  }

  /** Ask for a move of something that is drawn: not before it was sent to be drawn. */
  nudge(what) {
    if (this.waiting || !this.ready) this.later.push(what);
    else this.sendNudge(what);
  }

  sendNudge(what) {
    this.nudges += 1;
    this.send({ type: "nudge", ...what });
  }

  receive(message) {
    if (message.type === "scene") this.ready = true;
    if (message.request === "nudge") this.nudged += 1;
    if (message.request === "draw") {
      this.drawing = false;
      const { waiting } = this;
      this.waiting = null;
      if (waiting) this.draw(waiting);
    }
    this.handlers[message.type]?.(message);
  }

  async lost(event) {
    this.ready = false;
    const { words, fault, again } = await lossOf(event);
    this.handlers.lost(fault ? "A fault of the service" : "No connection", words);
    if (again) setTimeout(() => this.connect(), 1500);
  }
}

/** Of a study of the cup's places, along each axis of the plate. */
const STUDIED_PLACES = 8;

class Editor {
  constructor(capabilities) {
    Object.assign(this, { capabilities, chosen: null, errors: [], warnings: [], accepted: null, moves: 0, checking: false, plan: null, lastPlan: null, places: new Map(), written: new Map() });
    this.draft = new TaskDraft(() => this.changed());
    this.fields = new Fields(this);
    this.frame = byId("scene-frame");
    this.connection = new SceneConnection({
      scene: ({ scene }) => this.sceneOpened(new URL(scene, location.href).pathname),
      draft: ({ task }) => this.begin(task),
      moved: (message) => this.moved(message),
      chosen: ({ pointer }) => this.choose(pointer),
      refused: ({ request, detail }) => this.refused(request, detail),
      fault: ({ request, detail }) => {
        if (request === "judge") this.pathJudged(null);
        this.say("A fault of the service", detail);
      },
      result: (message) => this.showResult(message),
      judged: ({ feasibility }) => this.pathJudged(feasibility),
      way: ({ feasibility }) => this.showFeasibility(this.ofPath, feasibility),
      lost: (title, words) => this.say(title, words),
    });
    byId("undo").onclick = () => this.draft.undo();
    byId("redo").onclick = () => this.draft.redo();
    byId("copy-json").onclick = (event) => copy(event.target, JSON.stringify(this.draft.task, null, 2));
    byId("copy-curl").onclick = (event) => copy(event.target, this.curl());
    byId("plan").onclick = () => this.post();
    byId("resting").onchange = () => this.planAtRest();
    byId("cup-study").onclick = () => this.studyCup();
    byId("views").append(...VIEWS.map((view) => {
      const words = view[0].toUpperCase() + view.slice(1);
      return element("button", { textContent: words, onclick: () => this.connection.send({ type: "view", view }) });
    }));
    window.addEventListener("keydown", (event) => this.key(event));
    adoptFrame(this.frame, (event) => this.key(event, true));
    this.fillStart();
  }

  sceneOpened(address) {
    this.say();
    [this.moves, this.judging] = [0, false];
    this.written.clear();
    this.showFeasibility(null, null);
    this.connection.send({ type: "detail", light: LIGHT });
    this.frame.src = frameAddress(address, LIGHT);
    if (Object.keys(this.draft.task).length) {
      // The service was away, and may be another version now.
      this.askSoon();
      if (this.lastPlan) this.connection.send({ type: "path", plan: this.lastPlan });
      return this.show();
    }
    const kept = keptDraft();
    if (kept) {
      this.lastPlan = kept.lastPlan;
      return this.begin(kept.task);
    }
    const asked = new URLSearchParams(location.search);
    for (const of of ["plan", "example", "scene"])
      if (asked.get(of)) {
        if (of === "plan") this.lastPlan = asked.get(of);
        return this.connection.send({ type: "start", of, name: asked.get(of) });
      }
    this.beginEmpty(asked);
  }

  beginEmpty(asked) {
    const empty = EMPTY[asked.get("kind")] ?? EMPTY.plate_lift;
    this.begin(asked.get("cell") ? { ...empty, cell: asked.get("cell") } : empty);
  }

  /** Say what the scene cannot do; where that was to begin with something, an empty task is there instead. */
  refused(request, detail) {
    if (request === "path") return;
    // Nobody has asked for that: the next change is judged again.
    if (request === "judge") return this.pathJudged(null);
    if (request === "start" && !Object.keys(this.draft.task).length) {
      this.lastPlan = null;
      this.beginEmpty(new URLSearchParams());
    }
    this.say("That cannot be done", detail);
  }

  begin(task) {
    this.chosen = null;
    this.draft.begin(task);
    this.choose(thingsOf(task)[0]?.pointer ?? null);
    if (this.lastPlan) this.connection.send({ type: "path", plan: this.lastPlan });
  }

  /** Choices of what to begin with: empty tasks, the examples, perceived scenes. */
  async fillStart() {
    const start = byId("start");
    const add = (label, options) => {
      if (!options.length) return;
      const made = element("optgroup", { label });
      made.append(...options.map(([value, words]) => element("option", { value, textContent: words })));
      start.append(made);
    };
    start.append(element("option", { value: "", textContent: "this task" }));
    add("Empty", Object.entries(KIND_WORDS).map(([kind, words]) => [`kind=${kind}`, words]));
    for (const [kind, names] of Object.entries(this.capabilities.example_tasks)) add(`${KIND_WORDS[kind] ?? kind}: examples`, names.map((name) => [`example=${name}`, name]));
    const scenes = await fetch("../v1/scenes?page_size=50");
    if (scenes.ok) add("Perceived scenes", (await scenes.json()).scenes.map(({ id, external_id }) => [`scene=${id}`, external_id ?? id.slice(0, 8)]));
    start.onchange = () => {
      const [of, name] = start.value.split("=");
      start.value = "";
      this.lastPlan = null;
      this.showFeasibility(null, null);
      this.connection.send({ type: "path", plan: null });
      if (of === "kind") return this.begin(EMPTY[name]);
      if (of) this.connection.send({ type: "start", of, name });
    };
  }

  get things() {
    return thingsOf(this.draft.task);
  }

  /** The thing that an error's pointer concerns: the one that owns the longest member that it leads into. */
  thingOf(pointer) {
    let best = null, length = 0;
    for (const thing of this.things)
      for (const own of thing.owns) if (within(pointer, own) && own.length > length) [best, length] = [thing, own.length];
    return best;
  }

  /** Everything follows the draft: lists, values, the scene, and what the service says. */
  changed() {
    // What could not be done before may be now.
    if (this.connection.ready) this.say();
    this.noteWritten();
    if (!this.things.some(({ pointer }) => pointer === this.chosen)) this.chosen = null;
    clearTimeout(this.resting);
    keepDraft({ task: this.draft.task, lastPlan: this.lastPlan });
    this.show();
    this.askSoon();
    this.judge();
  }

  /** Note which places were written since, and how many moves had been sent until then. */
  noteWritten() {
    for (const { pointer } of this.things) {
      const place = JSON.stringify(this.draft.get(pointer));
      if (place !== this.places.get(pointer)) this.written.set(pointer, this.connection.nudges);
      this.places.set(pointer, place);
    }
  }

  /** Ask whether the last path holds for the lift of now, or else another way; of questions that come meanwhile, the last counts. */
  judge() {
    if (this.draft.task.kind !== "plate_lift" || this.judging) {
      this.toJudge = this.judging;
      return;
    }
    [this.judging, this.toJudge] = [true, false];
    this.connection.send({ type: "judge", task: this.draft.task });
  }

  pathJudged(ofPath) {
    this.judging = false;
    if (this.toJudge) this.judge();
    // What was told of other ways stays, as of before, until the answer for now is there.
    this.showFeasibility(ofPath, ofPath?.holds ? null : this.ofWays, true);
  }

  showFeasibility(ofPath, ofWays, before = false) {
    [this.ofPath, this.ofWays] = [ofPath, ofWays];
    const place = byId("feasibility");
    const lines = [[ofPath, false], [ofWays, before]].filter(([told]) => told);
    place.hidden = !lines.length;
    place.className = lines.at(-1)?.[0].holds ? "holds" : "fails";
    place.replaceChildren(...lines.map(([{ words }, old]) => element("p", { textContent: words, className: old ? "before" : "" })));
  }

  show() {
    byId("undo").disabled = !this.draft.past.length;
    byId("redo").disabled = !this.draft.future.length;
    byId("subtitle").textContent = KIND_WORDS[this.draft.task.kind] ?? "";
    byId("title").textContent = this.draft.task.external_id || "New task";
    document.title = `${byId("title").textContent} · Liftwright`;
    this.listThings();
    this.fields.show();
    const wrong = [...new Set(this.errors.map(({ pointer }) => this.thingOf(pointer)?.pointer).filter(Boolean))];
    this.connection.draw({ task: this.draft.task, chosen: this.chosen, wrong, moves: this.moves });
  }

  choose(pointer) {
    this.chosen = pointer;
    this.show();
  }

  listThings() {
    const wrong = new Set(this.errors.map((error) => this.thingOf(error.pointer)?.pointer));
    const rows = this.things.map((thing) => {
      const button = element("button", { textContent: thing.words, className: `${thing.kind} ${wrong.has(thing.pointer) ? "wrong" : ""}`, onclick: () => this.choose(thing.pointer) });
      button.dataset.pointer = thing.pointer;
      button.setAttribute("aria-pressed", String(thing.pointer === this.chosen));
      const row = element("li", {}, button);
      if (["object", "obstacle"].includes(thing.kind)) row.append(this.small("2×", `Double ${thing.words}`, () => this.double(thing)));
      if (!["goal", "tool"].includes(thing.kind)) row.append(this.small("✕", `Take ${thing.words} away`, () => this.remove(thing)));
      return row;
    });
    if (!rows.length) rows.push(element("li", { className: "none", textContent: "Nothing yet." }));
    keepFocus(byId("things"), rows);
    const needed = (name) => this.errors.some(({ pointer, detail }) => detail === "is required" && within(pointer, `/${name}`)) || (name === "object" && this.errors.some(({ pointer }) => pointer === "/objects"));
    keepFocus(byId("additions"), addable(this.draft.task, this.capabilities).map(([name, words, add]) =>
      Object.assign(element("button", { textContent: words, className: needed(name) ? "needed" : "", onclick: () => this.add(add) }), { id: `add-${name}` })));
  }

  small(sign, words, onclick) {
    const button = element("button", { className: "small", textContent: sign, title: words, onclick });
    button.setAttribute("aria-label", words);
    return button;
  }

  add(make) {
    let pointer = null;
    this.draft.together((task) => (pointer = make(task)));
    this.choose(pointer);
    this.nudge([0, 0], 0);
    this.focusThing(pointer);
  }

  focusThing(pointer) {
    byId("things").querySelector(`[data-pointer="${CSS.escape(pointer)}"]`)?.focus();
  }

  double(thing) {
    const all = thing.base.split("/")[1];
    let pointer = null;
    this.draft.together((task) => {
      const twin = structuredClone(this.draft.get(thing.base));
      twin.name = freeName(task, String(twin.name ?? thing.kind).replace(/_\d+$/, ""));
      for (const member of ["pose", "goal_pose"]) if (twin[member]) twin[member][1] = rounded(twin[member][1] + 0.15);
      pointer = `/${all}/${task[all].push(twin) - 1}/pose`;
    });
    this.choose(pointer);
    this.nudge([0, 0], 0);
    this.focusThing(pointer);
  }

  remove(thing) {
    if (thing.kind === "plate") this.draft.together((task) => (delete task.plate, delete task.plate_pose));
    else this.draft.remove(thing.base);
    const left = this.things;
    this.choose(left.at(-1)?.pointer ?? null);
    if (this.chosen) this.focusThing(this.chosen);
    else byId("additions").querySelector("button")?.focus();
  }

  nudge(by, turn) {
    if (this.chosen) this.connection.nudge({ pointer: this.chosen, by, turn });
  }

  moved({ pointer, value, phase, number }) {
    this.moves = number;
    // What was asked for before somebody wrote another place is over.
    if (this.connection.nudged < this.written.get(pointer)) return this.show();
    if (phase !== "end") this.chosen = pointer;
    this.places.set(pointer, JSON.stringify(value));
    this.draft.set(pointer, value);
    if (phase === "end") {
      this.draft.rest();
      this.show();
    }
  }

  /** Ask the service what it would say, once the last question is answered. */
  askSoon() {
    this.asked = true;
    if (!this.checking) this.ask();
  }

  async ask() {
    this.checking = true;
    while (this.asked) {
      this.asked = false;
      await new Promise((done) => setTimeout(done, CHECK_MILLISECONDS));
      try {
        const answer = await fetch("../v1/tasks/check", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(this.draft.task) });
        const told = await answer.json();
        if (this.asked) continue;
        this.warnings = answer.ok ? told.warnings : [];
        this.errors = answer.ok ? told.errors : [{ pointer: "", detail: told.detail }];
        this.keepAccepted(told.task);
        this.judged(answer.ok && told.accepted);
      } catch {
        this.unanswered();
      }
    }
    this.checking = false;
  }

  /** Keep what the service would take, with its defaults: those of a task that is refused meanwhile are the same. */
  keepAccepted(accepted) {
    const { kind, cell } = this.draft.task;
    if (accepted) this.accepted = accepted;
    else if (this.accepted?.kind !== kind || this.accepted.cell !== (cell ?? this.capabilities.default_cells[kind])) this.accepted = null;
  }

  /** Say that nobody knows what the service would say, and look again until somebody does. */
  unanswered() {
    const status = byId("check-status");
    [status.className, status.textContent] = ["no", "The service does not answer."];
    byId("refusals").replaceChildren();
    byId("plan").disabled = true;
    setTimeout(() => this.askSoon(), AWAY_MILLISECONDS);
  }

  verdict(accepted) {
    if (accepted) return ["The service would take this task.", ...this.warnings.map(({ pointer, detail }) => `${pointer}: ${detail}.`)].join(" ");
    return this.errors.length === 1 ? "The service would refuse this:" : `The service would refuse this, for ${this.errors.length} reasons:`;
  }

  /** Show what the service says, each thing at what it concerns. */
  judged(accepted) {
    const status = byId("check-status");
    const begun = this.things.length > 0 || accepted || this.errors.some(({ pointer }) => pointer === "/cell");
    status.className = accepted ? "yes" : begun ? "no" : "empty";
    status.textContent = begun ? this.verdict(accepted) : `Add ${this.draft.task.kind === "plate_lift" ? "a plate and a cup" : "objects"}, or begin with an example.`;
    keepFocus(byId("refusals"), (begun ? this.errors : []).slice(0, 20).map((error) => {
      const thing = this.thingOf(error.pointer);
      const where = error.detail.startsWith(thing?.words) ? "" : `${[thing?.words, this.labelOf(thing, error.pointer)].filter(Boolean).join(", ") || error.pointer || "the task"}: `;
      const button = element("button", { title: error.pointer, onclick: () => this.goTo(error) }, element("b", { textContent: where }), error.detail, ...choicesOf(error));
      button.id = `refusal${error.pointer}`;
      return element("li", {}, button);
    }));
    byId("plan").disabled = !accepted;
    byId("cup-study").hidden = !accepted || this.draft.task.kind !== "plate_lift";
    this.show();
    this.planAtRest();
  }

  /** What the field of a member is called; null: none stands for just that. */
  labelOf(thing, pointer) {
    const groups = [...(thing ? fieldsOf(thing, this.draft, this.capabilities) : []), ...taskFields(this.draft.task, this.capabilities)];
    return groups.flatMap(({ fields }) => fields).find((field) => field.pointer === pointer && field.label)?.label.toLowerCase() ?? null;
  }

  /** Plan by itself what is taken and was not planned yet, once nothing has changed for a while. */
  planAtRest() {
    clearTimeout(this.resting);
    if (!byId("resting").checked || byId("plan").disabled || JSON.stringify(this.draft.task) === this.posted) return;
    this.resting = setTimeout(() => !this.checking && this.post(), REST_MILLISECONDS);
  }

  goTo({ pointer }) {
    const thing = this.thingOf(pointer);
    if (thing) this.choose(thing.pointer);
    else if (byId(`add-${pointer.split("/")[1]}`)) return byId(`add-${pointer.split("/")[1]}`).focus();
    else byId("task-details").open = true;
    this.fields.focus(pointer);
  }

  curl() {
    const body = JSON.stringify(this.draft.task).replaceAll("'", "'\\''");
    return curlLine(this.capabilities, `'${body}'`);
  }

  async post() {
    byId("planning").hidden = false;
    byId("plan-status").textContent = "Posting the task …";
    this.before = this.lastPlan;
    this.posted = JSON.stringify(this.draft.task);
    byId("plan-progress").hidden = true;
    byId("plan-result").replaceChildren();
    byId("plan-links").replaceChildren();
    byId("plan").disabled = true;
    try {
      // What was begun for an older task is not waited for any more.
      if (this.running) await fetch(this.running, { method: "POST" });
      const answer = await fetch("../v1/plans", { method: "POST", headers: { "Content-Type": "application/json" }, body: this.posted });
      const told = await answer.json();
      if (!answer.ok) throw new Error(told.detail);
      byId("plan-progress").hidden = false;
      this.follow(told);
      byId("plan").disabled = false;
    } catch (error) {
      byId("plan-status").textContent = error instanceof TypeError ? "The task was not posted: the service does not answer." : error.message;
      this.posted = null;
      this.askSoon();
    }
  }

  /** Have the task planned with its cup at places all over the plate, and lead to the map of them. */
  async studyCup() {
    const { task } = this.draft;
    const { shape } = task.plate;
    const corners = shape.type === "box" ? [shape.size.map((size) => -size / 2), shape.size.map((size) => size / 2)] : shape.outline;
    const axes = [0, 1].map((axis) => {
      const along = corners.map((corner) => corner[axis]);
      return { pointer: `/cup/position/${axis}`, min: Math.min(...along) + task.cup.radius, max: Math.max(...along) - task.cup.radius, count: STUDIED_PLACES };
    });
    const body = JSON.stringify({ task: { ...task, cup: { ...task.cup, position: task.cup.position ?? [0, 0] } }, axes });
    byId("cup-study").disabled = true;
    byId("cup-map").hidden = true;
    try {
      const answer = await fetch("../v1/studies", { method: "POST", headers: { "Content-Type": "application/json" }, body });
      const told = await answer.json();
      if (!answer.ok) throw new Error(told.detail);
      [byId("cup-map").href, byId("cup-map").hidden] = [told.links.view, false];
    } catch (error) {
      [byId("planning").hidden, byId("plan-progress").hidden, byId("plan-status").textContent] = [false, true, error.message];
    } finally {
      byId("cup-study").disabled = false;
    }
  }

  /** Tell how a plan comes on, until it has ended or another one is asked for. */
  async follow(plan) {
    [this.plan, this.running] = [plan.id, plan.links.cancel];
    for (let shown = null; this.plan === plan.id;) {
      const { state, done, progress, outcome, verdict, error, links } = plan;
      const stage = verdict ? afterVerdict(verdict, progress.stage) : `Planning: ${(progress.stage ?? "begins").replaceAll("_", " ")}`;
      byId("plan-progress").value = progress.fraction;
      byId("plan-progress").hidden = done;
      byId("plan-status").textContent = done ? "" : state === "queued" ? "Waiting for its turn" : `${stage}, ${Math.round(100 * progress.fraction)} %`;
      byId("plan-links").replaceChildren(...(done ? this.linksOf(plan) : [element("button", { textContent: "Cancel", onclick: () => fetch(links.cancel, { method: "POST" }) })]));
      if (done) {
        this.running = null;
        if (!outcome) return byId("plan-status").replaceChildren(element("span", { className: "badge failed", textContent: state }), error?.detail ?? "");
        this.connection.send({ type: "path", plan: plan.id });
        this.lastPlan = plan.id;
        history.replaceState(null, "", `?plan=${plan.id}`);
        keepDraft({ task: this.draft.task, lastPlan: this.lastPlan });
        return;
      }
      // What is known already is shown, and once more when everything is.
      if (verdict && !shown) this.connection.send({ type: "path", plan: plan.id });
      shown = verdict;
      await new Promise((wait) => setTimeout(wait, POLL_MILLISECONDS));
      try {
        const answer = await fetch(links.self);
        if (answer.ok) plan = await answer.json();
        else if (answer.status === 404) return this.forgotten();
      } catch {
        byId("plan-status").textContent = "The service does not answer; the plan is shown once it does.";
        await new Promise((wait) => setTimeout(wait, AWAY_MILLISECONDS));
      }
    }
  }

  /** Say that the plan that was waited for is there no more. */
  forgotten() {
    [this.plan, this.running] = [null, null];
    byId("plan-progress").hidden = true;
    byId("plan-links").replaceChildren();
    byId("plan-status").textContent = "This plan was deleted meanwhile.";
  }

  linksOf({ id, links, outcome }) {
    if (!outcome) return [];
    return [
      element("button", { id: "watch", textContent: "Watch here", onclick: () => this.watch(id) }),
      element("a", { href: links.view, target: "_blank", textContent: "Open in the viewer" }),
      element("a", { href: links.document, target: "_blank", textContent: "Document" }),
      ...(this.before ? [element("a", { href: `compare?plans=${this.before},${id}`, target: "_blank", textContent: "Compare with the plan before" })] : []),
    ];
  }

  /** Show the viewer with a plan in the place of the scene, or the scene again. */
  watch(plan) {
    const frame = byId("watch-frame");
    frame.hidden = !frame.hidden;
    if (frame.hidden) frame.removeAttribute("src");
    else frame.src = `./?plan=${plan}`;
    byId("watch").textContent = frame.hidden ? "Watch here" : "Back to the task";
  }

  /** What came of the plan whose path is drawn now. */
  showResult({ plan, description }) {
    this.judge();
    if (plan !== this.plan) return;
    const { outcome, outcome_words, outcome_meaning, summary, causes, remedies, highlights } = description;
    byId("plan-status").replaceChildren(element("span", { className: `badge ${outcome}`, textContent: outcome_words }), outcome === "solved" ? "" : outcome_meaning);
    const facts = highlights.map(([label, value]) => element("div", {}, element("dt", { textContent: label }), element("dd", { textContent: value })));
    byId("plan-result").replaceChildren(
      ...(outcome === "solved" ? [element("dl", {}, ...facts)] : [element("p", { textContent: summary })]),
      ...(remedies ?? []).filter(({ task }) => task).map(({ sentence, figures, task }) =>
        element("p", { className: "remedy" }, element("button", { textContent: "Apply", title: "Change the task so", onclick: () => this.draft.begin(task) }), `${sentence} (${figures})`)),
      ...(outcome === "solved" ? [] : [element("ul", {}, ...causes.map(({ reason, numbers }) => element("li", {}, reason, numbers ? ` (${numbers})` : "")))]),
    );
  }

  key(event, inScene = false) {
    const typing = !inScene && ["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) && event.target.type !== "checkbox";
    const command = event.ctrlKey || event.metaKey;
    const take = (action) => {
      event.preventDefault();
      event.stopImmediatePropagation();
      action();
    };
    if (command && event.key === "Enter") return byId("plan").disabled || take(() => this.post());
    if (typing || event.altKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (command && key === "z") return take(() => (event.shiftKey ? this.draft.redo() : this.draft.undo()));
    if (command && key === "y") return take(() => this.draft.redo());
    if (command || !this.chosen) return;
    if (ARROWS[key]) return take(() => this.nudge(ARROWS[key].map((way) => way * (event.shiftKey ? FINE_MOVE : MOVE)), 0));
    if (key === "q" || key === "e") return take(() => this.nudge([0, 0], (key === "q" ? 1 : -1) * (event.shiftKey ? FINE_TURN : TURN)));
    if (key === "Delete") {
      const thing = this.things.find(({ pointer }) => pointer === this.chosen);
      if (thing && !["goal", "tool"].includes(thing.kind)) take(() => this.remove(thing));
    }
  }

  /** Say something in place of the scene: a title and words; nothing to let the scene be seen. */
  say(title, ...words) {
    byId("message").replaceChildren(...(title ? [element("h2", { textContent: title })] : []), ...words.map((part) => element("p", { textContent: part })));
  }
}

/** The values of what is chosen, and of the task as a whole. */
class Fields {
  constructor(editor) {
    Object.assign(this, { editor, made: { thing: "", task: "" }, refreshers: { thing: [], task: [] }, slots: [] });
  }

  get draft() {
    return this.editor.draft;
  }

  show() {
    const { editor } = this;
    const thing = editor.things.find(({ pointer }) => pointer === editor.chosen);
    const groups = thing ? fieldsOf(thing, this.draft, editor.capabilities) : [];
    this.build("thing", byId("thing-fields"), groups, thing ? [element("h3", {}, thing.words)] : [element("p", { textContent: "Choose a thing to see its values." })], thing?.pointer);
    this.build("task", byId("task-fields"), taskFields(this.draft.task, editor.capabilities), []);
    for (const refresh of [...this.refreshers.thing, ...this.refreshers.task]) refresh();
    this.showErrors();
  }

  /** Make the inputs anew where other ones are needed, so that nobody loses the one they type in. */
  build(part, box, groups, head, key = "") {
    const signature = JSON.stringify([key, head.map((each) => each.textContent), groups]);
    if (signature === this.made[part]) return;
    this.made[part] = signature;
    this.refreshers[part] = [];
    this.part = part;
    const focused = box.contains(document.activeElement) ? document.activeElement.id : null;
    box.replaceChildren(...head, ...groups.map(({ title, fields }) => {
      const set = element("fieldset", {}, element("legend", { textContent: title }));
      for (const field of fields) set.append(...this.field(field));
      return set;
    }));
    if (focused) byId(focused)?.focus();
  }

  field(field) {
    switch (field.type) {
      case "act": return this.act(field);
      case "words": return [element("p", { textContent: field.words })];
      case "number": return [this.number(field)];
      case "text": return [this.text(field)];
      case "select": return [this.select(field)];
      case "shape": return [this.select({ ...field, set: (type) => this.draft.set(field.shape, structuredClone(SHAPES[type])) })];
      case "check": return [this.check(field)];
      case "table": return [this.table(field)];
      case "vector": return [...this.vector(field), this.errors(field)];
      case "errors": return [this.errors(field)];
      case "pose": return this.pose(field);
      default: throw new Error(`no field ${field.type}`);
    }
  }

  /** A label with its input, and room for what is wrong with the member. */
  row(label, input, pointer, { unit, className = "" } = {}) {
    const id = `field${pointer}`.replaceAll("/", "-");
    input.id = id;
    const error = element("p", { className: "error", id: `${id}-error` });
    error.dataset.pointer = pointer;
    input.setAttribute("aria-describedby", error.id);
    const words = element("label", { htmlFor: id, textContent: label });
    if (unit) input.setAttribute("aria-label", `${label}, ${unit}`);
    const row = element("div", { className: `field ${className}` }, ...(className === "tick" ? [input, words] : [words, input]));
    if (unit !== undefined) row.append(element("span", { className: "unit", textContent: unit }));
    row.append(error);
    return row;
  }

  refresh(input, update) {
    this.refreshers[this.part].push(() => document.activeElement !== input && update());
    update();
  }

  value(pointer) {
    return this.draft.get(pointer);
  }

  /** What the service takes for a member that the task leaves out. */
  preset(pointer) {
    const { accepted } = this.editor;
    return accepted ? steps(pointer).reduce((value, step) => value?.[step], accepted) : undefined;
  }

  number({ label, pointer, unit, factor, step, optional, fallback, read, write }) {
    const input = element("input", { type: "number", step: "any", inputMode: "decimal" });
    const get = read ?? (() => this.value(pointer));
    const set = write ?? ((value) => (value === null && optional ? this.draft.remove(pointer) : this.draft.set(pointer, value)));
    const shown = (value) => (typeof value === "number" ? String(rounded(value * factor, 4)) : "");
    this.refresh(input, () => {
      input.value = shown(get());
      input.placeholder = optional ? shown(this.preset(pointer) ?? fallback) : "";
    });
    input.oninput = () => set(input.value === "" || !Number.isFinite(input.valueAsNumber) ? null : rounded(input.valueAsNumber / factor));
    input.onblur = () => (this.draft.rest(), (input.value = shown(get())));
    // The step counts from what is there, not from a grid of the browser's.
    input.onkeydown = (event) => {
      const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
      if (!way) return;
      event.preventDefault();
      const now = Number.isFinite(input.valueAsNumber) ? input.valueAsNumber : Number(input.placeholder || 0);
      input.value = String(rounded(now + way * step * (event.shiftKey ? 0.1 : 1), 6));
      input.oninput();
    };
    return this.row(label, input, pointer, { unit });
  }

  text({ label, pointer, optional }) {
    const input = element("input", { type: "text", autocomplete: "off", spellcheck: false });
    this.refresh(input, () => (input.value = this.value(pointer) ?? ""));
    input.oninput = () => (input.value === "" && optional ? this.draft.remove(pointer) : this.draft.set(pointer, input.value));
    input.onblur = () => this.draft.rest();
    return this.row(label, input, pointer, { className: "long" });
  }

  select({ label, pointer, choices, optional, set }) {
    const input = element("select");
    this.refresh(input, () => {
      const value = this.value(pointer);
      const preset = this.preset(pointer);
      const blank = optional ? [element("option", { value: "", textContent: typeof preset === "string" && value === undefined ? `${preset} (default)` : "default" })] : [];
      const all = value === undefined || choices.includes(value) ? choices : [...choices, value];
      input.replaceChildren(...blank, ...(value === undefined && !optional ? [element("option", { value: "", textContent: "…" })] : []), ...all.map((choice) => element("option", { value: choice, textContent: String(choice).replaceAll("_", " ") })));
      input.value = value ?? "";
    });
    input.onchange = () => (input.value === "" ? this.draft.remove(pointer) : set ? set(input.value) : this.draft.set(pointer, input.value));
    return this.row(label, input, pointer, { className: "long" });
  }

  check({ label, pointer, preset }) {
    const input = element("input", { type: "checkbox" });
    this.refresh(input, () => (input.checked = this.value(pointer) ?? preset));
    input.onchange = () => this.draft.set(pointer, input.checked);
    return this.row(label, input, pointer, { className: "tick" });
  }

  act({ label, pointer, act }) {
    return [element("div", { className: "field-row" }, element("button", { id: `field${pointer}`.replaceAll("/", "-"), textContent: label, onclick: act }))];
  }

  /** Rows of numbers; with `columns` they are one list, so many to a line, which may be left out. */
  table({ label, pointer, factor, columns }) {
    const input = element("textarea", { rows: columns ? 2 : 4, spellcheck: false });
    const rows = () => {
      const value = list(this.value(pointer));
      return columns ? Array.from({ length: Math.ceil(value.length / columns) }, (_, row) => value.slice(row * columns, (row + 1) * columns)) : value;
    };
    const read = (word) => (word === "" ? null : Number.isFinite(Number(word)) ? rounded(Number(word) / factor) : word);
    this.refresh(input, () => (input.value = rows().map((row) => list(row).map((value) => rounded(factor * value, 4)).join(" ")).join("\n")));
    input.oninput = () => {
      const typed = input.value.trim().split("\n").map((line) => line.trim().split(/[\s,]+/).map(read));
      if (columns && !input.value.trim()) this.draft.remove(pointer);
      else this.draft.set(pointer, columns ? typed.flat() : typed);
    };
    input.onblur = () => this.draft.rest();
    return this.row(label, input, pointer, { className: "wide" });
  }

  /** Three lengths that may be left out, all together: what the service takes for them is shown, and is there for the others
   *  when one is typed. */
  vector({ label, pointer }) {
    const now = () => this.value(pointer) ?? this.preset(pointer) ?? [0, 0, 0];
    return ["x", "y", "z"].map((axis, index) => this.number({
      label: `${label}, ${axis}`, pointer: `${pointer}/${index}`, ...MM, optional: true,
      read: () => this.value(pointer)?.[index],
      // A field that is emptied, or has but a sign yet, is 0 while another is not; none is left out alone.
      write: (value) => {
        const lengths = Object.assign([...now()], { [index]: value ?? 0 });
        if (value === null && lengths.every((length) => length === 0)) this.draft.remove(pointer);
        else this.draft.set(pointer, lengths);
      },
    }));
  }

  /** Room for what is wrong with a member as a whole. */
  errors({ pointer }) {
    const room = element("p", { className: "error" });
    room.dataset.pointer = pointer;
    return room;
  }

  pose({ pointer, optional }) {
    const pose = () => this.value(pointer);
    if (optional && !pose()) {
      const put = () => this.draft.set(pointer, [0.45, 0.3, tableTop(this.draft.task, this.editor.capabilities), 1, 0, 0, 0]);
      return [element("p", { textContent: `It is ${optional}.` }), element("button", { textContent: "Put it on the table", onclick: () => (put(), this.editor.nudge([0, 0], 0)) })];
    }
    const part = (index) => ({
      read: () => pose()?.[index],
      write: (value) => this.draft.set(pointer, Object.assign([...(pose() ?? [0, 0, 0, 1, 0, 0, 0])], { [index]: value })),
    });
    const rows = ["x, forward", "y, to the robot's left", "z, up"].map((label, index) => this.number({ label, pointer: `${pointer}/${index}`, ...MM, ...part(index) }));
    const yaw = {
      read: () => (list(pose()).every((value) => typeof value === "number") && pose()?.length === 7 ? yawOf(pose()) : undefined),
      write: (value) => value !== null && this.draft.set(pointer, withYaw(pose(), value)),
    };
    rows.push(this.number({ label: "Yaw", pointer: `${pointer}/yaw`, unit: "°", factor: 180 / Math.PI, step: 1, ...yaw }));
    const tip = (axis) => () => {
      this.draft.set(pointer, turned(pose(), [Math.SQRT1_2, ...axis.map((value) => value * Math.SQRT1_2)]));
      this.editor.nudge([0, 0], 0);
    };
    const buttons = [element("button", { textContent: "Put down", title: "Onto what is below it", onclick: () => this.editor.nudge([0, 0], 0) })];
    if (pointer.startsWith("/objects")) buttons.push(element("button", { textContent: "Tip about x", onclick: tip([1, 0, 0]) }), element("button", { textContent: "Tip about y", onclick: tip([0, 1, 0]) }));
    if (optional) buttons.push(element("button", { textContent: "Back to its rest", onclick: () => this.draft.remove(pointer) }));
    return [...rows, this.errors({ pointer }), element("div", { className: "field-row" }, ...buttons)];
  }

  /** Put what the service says to the fields: to the member itself, or to the nearest one that it is part of. */
  showErrors() {
    const slots = [...document.querySelectorAll("#fields .error")];
    const told = new Map(slots.map((slot) => [slot, []]));
    for (const error of this.editor.errors) {
      const around = slots.filter((slot) => within(error.pointer, slot.dataset.pointer)).sort((a, b) => b.dataset.pointer.length - a.dataset.pointer.length);
      const slot = around[0] ?? slots.find((each) => within(each.dataset.pointer, error.pointer));
      if (slot) told.get(slot).push(error);
    }
    for (const [slot, errors] of told) {
      const words = errors.map((error) => [error.detail, ...choicesOf(error).map((each) => each.textContent)].join(" ")).join("; ");
      if (slot.textContent !== words) slot.textContent = words;
      document.querySelector(`[aria-describedby="${CSS.escape(slot.id)}"]`)?.setAttribute("aria-invalid", String(errors.length > 0));
    }
  }

  focus(pointer) {
    const inputs = [...document.querySelectorAll("#fields [aria-describedby]")];
    const own = (input) => byId(input.getAttribute("aria-describedby")).dataset.pointer;
    (inputs.find((input) => own(input) === pointer) ?? inputs.find((input) => within(pointer, own(input))) ?? inputs.find((input) => within(own(input), pointer)))?.focus();
  }
}

/** Keep the draft of this address for when the page is loaded again, in this tab alone. */
/** What is being done to a task whose verdict is known, given the stage of its progress. */
function afterVerdict(verdict, stage) {
  if (verdict !== "solved") return "There is no plan; trying changes";
  return stage === "remedies" ? "Physics does not carry it out; trying changes" : "In physics";
}

function keepDraft(draft) {
  sessionStorage.setItem(`liftwright draft ${location.search}`, JSON.stringify(draft));
}

/** The draft that this page had before it was loaded again or come back to; null: it is opened anew. */
function keptDraft() {
  const [{ type }] = performance.getEntriesByType("navigation");
  return ["reload", "back_forward"].includes(type) ? JSON.parse(sessionStorage.getItem(`liftwright draft ${location.search}`)) : null;
}

/** The valid choices of an error, where they can be listed. */
function choicesOf({ allowed }) {
  return allowed?.length ? [element("small", { textContent: `Valid: ${allowed.join(", ")}` })] : [];
}

/** Put other children into a list, and leave the focus on the one that stands for the same. */
function keepFocus(box, children) {
  const name = (node) => node.dataset?.pointer ?? node.id ?? node.getAttribute("aria-label");
  const focused = box.contains(document.activeElement) ? document.activeElement : null;
  const fresh = element("div", {}, ...children);
  if (box.innerHTML === fresh.innerHTML) return;
  box.replaceChildren(...children);
  if (focused) [...box.querySelectorAll("button")].find((each) => name(each) === name(focused))?.focus();
}

async function copy(button, text) {
  const words = button.textContent;
  try {
    await navigator.clipboard.writeText(text);
    button.textContent = "Copied";
  } catch {
    button.textContent = "Not allowed";
  }
  setTimeout(() => (button.textContent = words), 1200);
}

let editor = null;
fetch("../v1/capabilities").then((answer) => answer.json()).then((capabilities) => (editor = new Editor(capabilities)));
