/* What all pages are made with: elements, and the frame in which viser's own page draws a scene. */
"use strict";

/* Panels, bars and notes of viser's page, in all of its layouts. */
const AROUND_THE_SCENE = ".mantine-Paper-root, [data-floating-window], .mantine-Notifications-root { display: none !important; }";

/** Whether the system wants dark pages. */
const DARK = matchMedia("(prefers-color-scheme: dark)");
/** Under which the browser keeps whether scenes are drawn lightly. */
const LIGHT_KEY = "liftwright light";
/** Places of the camera, by the names that the service knows. */
const VIEWS = ["overview", "front", "side", "top", "close"];

/** Give `onkey` the keys that are pressed while the scene has the focus, and hide what viser's page adds around its scene.
 *  That page writes itself anew while it loads, so this looks again and again whether it still holds. */
function adoptFrame(frame, onkey) {
  const look = () => {
    const page = frame.contentDocument;
    if (!page?.head || page.getElementById("liftwright-style")) return;
    page.head.append(Object.assign(page.createElement("style"), { id: "liftwright-style", textContent: AROUND_THE_SCENE }));
    page.addEventListener("keydown", onkey, true);
  };
  frame.addEventListener("load", look);
  setInterval(look, 250);
  if (rendererName() === null)
    frame.after(element("p", { className: "undrawn" }, "No scene is drawn here: this browser has no WebGL 2, or it is switched off."));
}

/** Make an element with properties and children. */
function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

/** The line of a shell that has this service plan what `data` is in curl's words. */
function curlLine({ needs_key }, data) {
  const key = needs_key ? '-H "Authorization: Bearer $KEY" ' : "";
  return `curl ${key}-H 'Content-Type: application/json' -d ${data} ${location.origin}/v1/plans`;
}

/** Day and time of a moment, written in one way in all browsers. */
function dated(moment) {
  return new Date(moment).toLocaleString("en-GB", { dateStyle: "short", timeStyle: "short" });
}

/** Ask for the plan of a point of a study, made now if there is none yet. An error says why there is none. */
async function planOfPoint(study, index) {
  const asked = { method: "POST", headers: { Accept: "application/json" } };
  const answer = await fetch(`../v1/studies/${encodeURIComponent(study)}/points/${index}/plan`, asked)
    .catch(() => { throw new Error("The service does not answer."); });
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.detail);
  return told;
}

/** Where viser's page draws a scene, given what the system wants, how much is drawn, and where the camera is and what it
 *  looks at, if that is not to be the scene's own first view. */
function frameAddress(scene, light, camera = null) {
  const query = new URLSearchParams();
  if (DARK.matches) query.set("darkMode", "");
  if (light) query.set("fixedDpr", Math.min(1, devicePixelRatio));
  if (camera) {
    query.set("initialCameraPosition", camera.slice(0, 3));
    query.set("initialCameraLookAt", camera.slice(3));
  }
  return `${scene}?${query}`;
}

/** Whether scenes are drawn lightly: as somebody wanted it in this browser, or where there is no graphics card. */
function drawsLightly() {
  return JSON.parse(localStorage.getItem(LIGHT_KEY)) ?? drawsInSoftware();
}

/** Whether this machine draws without a graphics card, or not at all. */
function drawsInSoftware() {
  const name = rendererName();
  return name === null || /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** What draws scenes in this browser; null: nothing does. */
function rendererName() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (!context) return null;
  const told = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : context.RENDERER);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return name;
}
