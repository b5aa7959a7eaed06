/* The start page: whether the service can work, and what it can plan. */
"use strict";

const ROWS = [["Tasks", "kinds"], ["Cells", "cells"], ["Lifters", "lifter_models"], ["Suction tools", "tools"]];

/** Milliseconds between two looks whether the service can work. */
const PAUSE = 5000;

let isTold = false;

/** Say whether the service can work, again and again: it may be stopped and started while this page is open. */
async function look() {
  const health = document.getElementById("health");
  try {
    const ready = await fetch("/readyz");
    health.className = `badge ${ready.ok ? "solved" : "failed"}`;
    health.textContent = ready.ok ? "ready" : (await ready.json()).detail;
    if (!isTold) await tell();
  } catch {
    health.className = "badge failed";
    health.textContent = "no connection";
  }
  setTimeout(look, PAUSE);
}

/** Say what the service can plan, and how a program asks it for a plan. */
async function tell() {
  const told = await (await fetch("/v1/capabilities")).json();
  const { name, version } = told.software;
  document.getElementById("version").textContent = `${name} ${version}`;
  document.getElementById("capabilities").replaceChildren(...ROWS.flatMap(([words, member]) => row(words, ...told[member].map(named))),
    ...row("Jobs at a time", String(told.limits.worker_slots)));
  document.getElementById("first-line").textContent = curlLine(told, "@assets/tasks/ab1.json");
  isTold = true;
}

function row(words, ...values) {
  return [element("dt", {}, words), element("dd", {}, ...values.flatMap((value) => [value, " "]))];
}

/** A name as tasks write it. */
function named(name) {
  return element("code", { textContent: name });
}

look();
