/* The page of cells: what there is, what each can do, and adding one's own. */
"use strict";

const TYPES = { zip: "application/zip", yaml: "application/yaml", yml: "application/yaml", json: "application/json" };
const byId = (id) => document.getElementById(id);
let shown = new URLSearchParams(location.search).get("cell");
let lists = 0;

async function call(path, options = {}) {
  const answer = await fetch(path, { headers: { Accept: "application/json" }, ...options });
  const body = answer.status === 204 ? null : await answer.json();
  if (!answer.ok) throw Object.assign(new Error(body?.detail ?? `the service answered ${answer.status}`), { errors: body?.errors ?? [] });
  return body;
}

const told = (cell) => cell.version === null ? "shipped" : `version ${cell.version}, ${dated(cell.created_at)}`;

async function list() {
  const number = ++lists;
  const { cells } = await call("/v1/cells");
  // A list that was asked for before lacks what was added since, and would show another cell.
  if (number !== lists) return;
  byId("cells").replaceChildren(...cells.map((cell) => element("li", {}, entry(cell))));
  const wanted = cells.find(({ id, name }) => shown === id || shown === name) ?? cells[0];
  if (wanted) await show(wanted);
}

function entry(cell) {
  const look = async () => {
    const looked = show(cell);
    // On a telephone it stands below the list.
    byId("shown").scrollIntoView({ block: "nearest" });
    await looked;
  };
  const button = element("button", { onclick: () => look().catch(refuse) }, cell.name, element("small", { textContent: told(cell) }));
  button.dataset.cell = cell.id;
  return button;
}

async function show(cell) {
  shown = cell.id;
  history.replaceState(null, "", `?cell=${encodeURIComponent(cell.id)}`);
  for (const button of byId("cells").querySelectorAll("button")) button.setAttribute("aria-current", button.dataset.cell === cell.id);
  byId("shown").hidden = false;
  byId("name").textContent = cell.name;
  byId("facts").textContent = `${told(cell)}. Tasks name it by "${cell.name}"${cell.version === null ? "" : `, this version for good by "${cell.id}"`}.`;
  byId("lift").href = `/viewer/new?kind=plate_lift&cell=${cell.name}`;
  byId("move").href = `/viewer/new?kind=suction_tool&cell=${cell.name}`;
  byId("json").href = cell.links.self;
  byId("files").hidden = cell.links.files === null;
  byId("files").href = cell.links.files ?? "";
  byId("delete").hidden = cell.version === null;
  byId("delete").onclick = () => remove(cell).catch(refuse);
  byId("large").href = byId("picture").src = cell.links.picture;
  byId("looking").hidden = false;
  byId("sentences").replaceChildren();
  for (const id of ["lift", "move"]) byId(id).hidden = true;
  byId("noted").hidden = true;
  const figures = await call(cell.links.survey).catch((error) => shown === cell.id && Promise.reject(error));
  if (shown !== cell.id) return;
  byId("looking").hidden = true;
  byId("sentences").replaceChildren(...figures.sentences.map((textContent) => element("li", { textContent })));
  byId("noted").hidden = !figures.notes.length;
  byId("notes").replaceChildren(...figures.notes.map((textContent) => element("li", { textContent })));
  const hands = Object.values(figures.arms).map(({ kind }) => kind);
  byId("lift").hidden = !(hands.includes("gripper") && hands.includes("stick"));
  byId("move").hidden = hands.includes("stick");
}

async function remove(cell) {
  if (!confirm(`Delete ${cell.name}, ${told(cell)}? Plans that are in it stay.`)) return;
  await call(cell.links.self, { method: "DELETE" });
  shown = null;
  await list();
}

async function add(file) {
  refuse();
  const type = TYPES[file.name.split(".").pop().toLowerCase()];
  if (!type) throw new Error(`${file.name} is neither a zip nor YAML nor JSON`);
  byId("state").textContent = `reading ${file.name} …`;
  const cell = await call("/v1/cells", { method: "POST", body: file, headers: { Accept: "application/json", "Content-Type": type } });
  shown = cell.id;
  byId("state").textContent = `${cell.name} is kept, ${told(cell)}`;
  await list();
}

function refuse(error = null) {
  byId("state").textContent = "";
  byId("looking").hidden = true;
  byId("refusal").textContent = error?.message ?? "";
  const faults = error?.errors ?? [];
  byId("faults").replaceChildren(...(faults.length > 1 ? faults : []).map(({ file, pointer, detail }) =>
    element("li", { textContent: [file, pointer, detail].filter(Boolean).join(": ") })));
}

byId("file").onchange = ({ target }) => {
  const [file] = target.files;
  target.value = "";
  if (file) add(file).catch(refuse);
};
list().catch(refuse);
