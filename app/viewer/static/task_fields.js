/* What can be set of each thing of a task, with units, and what a new thing is at first. */
"use strict";

const MM = { unit: "mm", factor: 1000, step: 1 };
const PERCENT = { unit: "%", factor: 100, step: 1 };
const NEWTON = { unit: "N", factor: 1, step: 0.5 };
const KAPPA = { ...NEWTON, step: 0.001 };
const RATIO = { unit: "", factor: 1, step: 0.05 };
const WHOLE = { unit: "", factor: 1, step: 1 };
const KILOGRAM = { unit: "kg", factor: 1, step: 0.1 };
const SHAPES = {
  box: { type: "box", size: [0.1, 0.1, 0.1] },
  cylinder: { type: "cylinder", radius: 0.04, height: 0.1 },
  prism: { type: "prism", outline: [[-0.1, -0.08], [0.1, -0.08], [0, 0.1]], height: 0.04 },
  mesh: { type: "mesh", asset: "can" },
};
/** Height of the table of a task's cell [m]; of the first cell that is known where the task names none or no such one. */
function tableTop(task, { cell_limits, default_cells }) {
  return (cell_limits[task.cell] ?? cell_limits[default_cells[task.kind]]).table.top;
}

/** Names of tools that a task may use: the shipped ones, and those that its cell brings. */
function toolNames(task, { tools, cell_limits }) {
  return [...new Set([...tools, ...(cell_limits[task.cell]?.tools ?? [])])].sort();
}

const EMPTY = {
  plate_lift: { kind: "plate_lift" },
  suction_tool: { kind: "suction_tool", objects: [] },
};
const KIND_WORDS = { plate_lift: "Plate lift", suction_tool: "Suction tool" };

const number = (label, pointer, unit, more = {}) => ({ type: "number", label, pointer, ...unit, ...more });
const select = (label, pointer, choices, more = {}) => ({ type: "select", label, pointer, choices, ...more });

/** All things of a task: `pointer` of the member that says where it is, `owns` the members that are its own, its name. */
function thingsOf(task) {
  const things = [];
  if (task.kind === "plate_lift") {
    if (task.plate || task.plate_pose) things.push({ pointer: "/plate_pose", owns: ["/plate", "/plate_pose"], words: "Plate", kind: "plate", base: "/plate" });
    if (task.cup) things.push({ pointer: "/cup/position", owns: ["/cup", "/lifter_model"], words: "Cup", kind: "cup", base: "/cup" });
    if (task.support) things.push({ pointer: "/support/pose", owns: ["/support"], words: "Support", kind: "support", base: "/support" });
  } else {
    things.push({ pointer: "/tool_pose", owns: ["/tool", "/tool_pose"], words: "Tool", kind: "tool", base: "/tool" });
  }
  for (const [index, object] of list(task.objects).entries()) {
    const base = `/objects/${index}`;
    const name = object?.name || `object ${index + 1}`;
    things.push({ pointer: `${base}/pose`, owns: [base], words: name, kind: "object", base });
    things.push({ pointer: `${base}/goal_pose`, owns: [`${base}/goal_pose`, `${base}/goal_symmetry`], words: `${name}, goal`, kind: "goal", base });
  }
  for (const [index, obstacle] of list(task.obstacles).entries()) {
    const base = `/obstacles/${index}`;
    things.push({ pointer: `${base}/pose`, owns: [base], words: obstacle?.name || `obstacle ${index + 1}`, kind: "obstacle", base });
  }
  return things;
}

function list(value) {
  return Array.isArray(value) ? value : [];
}

/** What can be added to a task, with what it is at first. */
function addable(task, capabilities) {
  const top = tableTop(task, capabilities);
  const additions = [];
  const lift = task.kind === "plate_lift";
  if (lift && !task.plate) additions.push(["plate", "Plate", (draft) => {
    draft.plate = { shape: { type: "box", size: [0.3, 0.3, 0.04] }, mass: 3 };
    draft.plate_pose = [0.3, 0, top + 0.02, 1, 0, 0, 0];
    return "/plate_pose";
  }]);
  if (lift && !task.cup) additions.push(["cup", "Cup", (draft) => {
    draft.cup = { position: [0.1, 0], radius: 0.0175, max_force: 20 };
    return "/cup/position";
  }]);
  if (lift && !task.support) additions.push(["support", "Support", (draft) => {
    draft.support = { shape: { type: "box", size: [0.4, 0.5, 0.044] }, pose: [0.3, 0, top + 0.022, 1, 0, 0, 0] };
    return "/support/pose";
  }]);
  if (!lift) additions.push(["object", "Object", (draft) => {
    draft.objects = list(draft.objects);
    const { length } = draft.objects;
    const x = 0.25 + 0.15 * (length % 3);
    const name = freeName(draft, "object");
    draft.objects.push({ name, shape: { type: "box", size: [0.12, 0.08, 0.06] }, mass: 0.3, pose: [x, 0.3, top + 0.03, 1, 0, 0, 0], goal_pose: [x, -0.3, top + 0.03, 1, 0, 0, 0] });
    return `/objects/${length}/pose`;
  }]);
  additions.push(["obstacle", "Obstacle", (draft) => {
    draft.obstacles = list(draft.obstacles);
    const name = freeName(draft, "obstacle");
    draft.obstacles.push({ name, shape: { type: "box", size: [0.1, 0.1, 0.1] }, pose: [0.6, 0.35, top + 0.05, 1, 0, 0, 0] });
    return `/obstacles/${draft.obstacles.length - 1}/pose`;
  }]);
  return additions;
}

/** A name that nothing else of the task has. */
function freeName(task, stem) {
  const taken = new Set([...list(task.objects), ...list(task.obstacles)].map((each) => each?.name));
  for (let index = 1; ; index += 1) if (!taken.has(`${stem}_${index}`)) return `${stem}_${index}`;
}

/** Groups of fields of a thing: [{ title, fields }]. */
function fieldsOf(thing, draft, capabilities) {
  const { base } = thing;
  const place = { title: "Place in the world", fields: [{ type: "pose", pointer: thing.pointer }] };
  switch (thing.kind) {
    case "plate":
      return [
        { title: "Shape", fields: shapeFields("/plate/shape", draft, ["box", "prism"], capabilities) },
        { title: "Mass", fields: [
          number("Mass", "/plate/mass", KILOGRAM),
          number("Mass may be off by", "/plate/mass_tolerance", PERCENT, { optional: true }),
          { type: "vector", label: "Centre of mass", pointer: "/plate/com" },
          number("Centre of mass may be off by", "/plate/com_tolerance", MM, { optional: true }),
        ] },
        place,
      ];
    case "cup":
      return [
        { title: "Place on the plate, from its origin", fields: draft.get("/cup/position")
          ? [
              number("x, along the plate", "/cup/position/0", MM), number("y, across the plate", "/cup/position/1", MM),
              { type: "errors", pointer: "/cup/position" },
              { type: "act", label: "Find the best place", pointer: "/cup/position", act: () => draft.remove("/cup/position") },
            ]
          : [
              { type: "words", words: "It is left open: planning finds where most of every limit is kept back, and says so." },
              { type: "act", label: "Put it on the plate", pointer: "/cup/position", act: () => draft.set("/cup/position", [0, 0]) },
            ] },
        { title: "Suction", fields: [
          number("Radius of the pad", "/cup/radius", MM, { step: 0.5 }), number("Largest force", "/cup/max_force", NEWTON),
          number("Friction of the pad", "/cup/mu", RATIO, { optional: true }), number("Bending, kappa", "/cup/kappa", KAPPA, { optional: true }),
          select("Lifter model", "/lifter_model", capabilities.lifter_models, { optional: true }),
        ] },
      ];
    case "support":
      return [{ title: "Shape", fields: shapeFields("/support/shape", draft, ["box", "cylinder", "prism"], capabilities) }, place];
    case "tool":
      return [
        ...(typeof draft.get("/tool") === "object" ? ownToolFields() : [{ title: "Tool", fields: [select("Tool", "/tool", toolNames(draft.task, capabilities), { optional: true })] }]),
        { ...place, fields: [{ type: "pose", pointer: "/tool_pose", optional: "in the cell's rest" }] },
      ];
    case "goal":
      return [
        { title: "Goal", fields: [select("As good when turned", `${base}/goal_symmetry`, ["none", "axis", "shape"], { optional: true })] },
        { ...place, title: "Where it is wanted" },
      ];
    default:
      return [
        { title: "Name", fields: [{ type: "text", label: "Name", pointer: `${base}/name` }, ...(draft.get("/scene_id") && !draft.get("/scene_filled") ? [{ type: "text", label: "Name in the scene", pointer: `${base}/detection`, optional: true }] : [])] },
        { title: "Shape", fields: shapeFields(`${base}/shape`, draft, capabilities.shapes, capabilities) },
        ...(thing.kind === "object" ? [{ title: "Mass", fields: [number("Mass", `${base}/mass`, KILOGRAM), { type: "vector", label: "Centre of mass", pointer: `${base}/com` }] }] : []),
        place,
      ];
  }
}

/** Of a tool that the task itself describes, all but its shapes. */
function ownToolFields() {
  return [
    { title: "A tool of the task's own", fields: [number("Mass", "/tool/mass", KILOGRAM), { type: "vector", label: "Centre of mass", pointer: "/tool/com" }] },
    { title: "Its cup", fields: [
      number("Radius of the lip", "/tool/cup/radius", MM, { step: 0.5 }), number("Largest force", "/tool/cup/max_force", NEWTON),
      number("Friction of the lip", "/tool/cup/mu", RATIO, { optional: true }), number("Bending, kappa", "/tool/cup/kappa", KAPPA, { optional: true }),
    ] },
  ];
}

function shapeFields(pointer, draft, types, capabilities) {
  const shape = draft.get(pointer) ?? {};
  const kind = { type: "shape", label: "Shape", pointer: `${pointer}/type`, shape: pointer, choices: types };
  switch (shape.type) {
    case "box":
      return [kind, number("Length, x", `${pointer}/size/0`, MM), number("Width, y", `${pointer}/size/1`, MM), number("Height, z", `${pointer}/size/2`, MM)];
    case "cylinder":
      return [kind, number("Radius", `${pointer}/radius`, MM), number("Height", `${pointer}/height`, MM)];
    case "prism":
      return [kind, { type: "table", label: "Corners, x y in mm, counter-clockwise", pointer: `${pointer}/outline`, factor: 1000 }, number("Height", `${pointer}/height`, MM)];
    case "mesh":
      return [
        kind,
        shape.upload === undefined ? select("Mesh", `${pointer}/asset`, capabilities.meshes) : { type: "text", label: "Upload", pointer: `${pointer}/upload` },
        number("Scale", `${pointer}/scale`, { unit: "", factor: 1, step: 0.001 }, { optional: true }),
      ];
    default:
      return [kind];
  }
}

/** Fields of the task as a whole. */
function taskFields(task, capabilities) {
  const lift = task.kind === "plate_lift";
  // Accepted suction-tool tasks state it only where it is another one than the default.
  const twisting = number("Torque over friction of a finger, eps", "/friction/eps", { ...MM, step: 0.5 }, { optional: true, fallback: 0.0075 });
  const seed = number("Seed of what is drawn by chance", "/seed", WHOLE, { optional: true });
  const own = lift
    ? [
        { title: "Forces", fields: [
          number("A hand's normal force", "/hand_force_limit/normal", NEWTON, { optional: true }), number("A hand's force in all", "/hand_force_limit/net", NEWTON, { optional: true }),
          select("How the gripper holds", "/contact_model", ["squeeze", "paper"], { optional: true }), number("Squeeze of each pad", "/hand_force_limit/squeeze", NEWTON, { optional: true }),
          number("Friction of the fingers", "/friction/grip", RATIO, { optional: true }), number("Friction of the stick", "/friction/push", RATIO, { optional: true }),
          number("Friction of the table", "/friction/environment", RATIO, { optional: true }), twisting,
        ] },
        { title: "Planning", fields: [
          number("Kept back of every limit", "/options/reserve", PERCENT, { optional: true }), number("Height at the end", "/options/goal_height", MM, { optional: true }),
          select("Least of", "/options/minimise", ["cost", "force", "risk"], { optional: true }),
          number("Poses tried, times as many", "/options/contact_density", { ...RATIO, step: 0.25 }, { optional: true }), number("Grips and pushes tried, times as many", "/options/hold_density", { ...RATIO, step: 0.25 }, { optional: true }),
          seed,
        ] },
      ]
    : [
        { title: "Forces", fields: [
          number("A finger's normal force", "/grip_force_limit", NEWTON, { optional: true }), number("What a hand may carry", "/carry_force_limit", NEWTON, { optional: true }),
          number("Friction of the fingers", "/friction/grip", RATIO, { optional: true }), number("Friction of what rests", "/friction/environment", RATIO, { optional: true }), twisting,
        ] },
        { title: "Planning", fields: [number("Kept back of every limit", "/options/reserve", PERCENT, { optional: true }), seed] },
      ];
  return [
    { title: "Task", fields: [{ type: "text", label: "Your name for it", pointer: "/external_id", optional: true }, select("Cell", "/cell", capabilities.cells, { optional: true })] },
    ...own,
    { title: "Beginning", fields: [{ type: "table", label: "Joints in degrees, the left arm's and below the right one's; empty: at home", pointer: "/start_positions", factor: 180 / Math.PI, columns: 6 }] },
    { title: "Afterwards", fields: [
      { type: "check", label: "Execute the plan in physics", pointer: "/options/simulate", preset: true },
      { type: "check", label: "Where there is no plan, look for changes that help", pointer: "/options/remedies", preset: true },
    ] },
  ];
}
