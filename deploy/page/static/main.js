// The page: one socket, one state, one drawing per frame.
import { Arena } from "./arena.js";
import { append, CHARTS, drawChart, drawStrip, fresh } from "./curves.js";
import { buildBelief, buildFigures, buildRoster, element, fillBelief, fillFigures, fillHelp, fillLegend, fillLog, fillRoster } from "./panels.js";

const $ = (id) => document.getElementById(id);
const SWITCHES = [["c", "cells", "cells"], ["p", "density", "density"], ["f", "footprints", "footprints"], ["o", "cods", "centroids of detection"], ["d", "detections", "detections"],
  ["t", "truth", "true targets"], ["e", "estimates", "estimates"], ["r", "trails", "trails"], ["n", "names", "names"]];
const RATE_WINDOW = 1500, BELIEF_PERIOD = 400, TABLE_PERIOD = 300; // ms

const state = {
  hello: null, frame: null, history: fresh(), happenings: new Map(), outlines: {}, order: new Map(), trails: { bodies: new Map(), targets: new Map() },
  on: Object.fromEntries(SWITCHES.map(([, name]) => [name, true])), chosen: null, belief: null, rate: null, counted: [], frames: 0, send,
};
window.covey = state; // for the curious, for tests and benchmarks
const arena = new Arena($("arena"), state);
const charts = CHARTS.map((chart) => {
  const canvas = element("canvas", { role: "img", "aria-label": `curve of ${chart.title}` });
  $("charts").append(element("figure", {}, canvas));
  canvas.addEventListener("click", (event) => seek((event.offsetX / canvas.clientWidth) * state.hello.ticks * state.hello.dt));
  return [canvas, chart];
});
let socket = null, over = false, tableAt = 0, scrubbing = false;

// ---------------------------------------------------------------- what arrives
function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? text(JSON.parse(data)) : picture(data));
  socket.onclose = () => {
    link(over ? "the run is over" : "no connection; trying again", true);
    setTimeout(connect, over ? 3000 : 700);
  };
}

function text(message) {
  if (message.type === "hello") hello(message);
  else if (message.type === "answer") answer(message.text, message.ok);
  else if (message.type === "bye") { over = true; link("the run is over", true); }
}

function hello(message) {
  const another = !state.hello || state.hello.run !== message.run || state.hello.agents.length !== message.agents.length;
  state.hello = message;
  over = false;
  state.history = fresh(message.curves);
  state.happenings = new Map(message.happenings.map((one) => [one[0], one]));
  state.outlines = Object.fromEntries(message.agents.map((agent) => [agent.name, agent.outline]));
  state.order = new Map(message.agents.map((agent, index) => [agent.name, index]));
  state.trails.bodies = new Map(Object.entries(message.trails.bodies));
  state.trails.targets = new Map(Object.entries(message.trails.targets));
  $("title").textContent = `${message.run}: ${message.scenario.split("/").pop()}, ${message.agents.length} agents, ${message.partition} diagram, seed ${message.seed}`;
  document.title = `${message.run} – Covey`;
  $("player").hidden = message.source !== "replay";
  charts[charts.length - 1][0].parentElement.hidden = message.source === "replay"; // how fast messages came is a matter of the live run
  $("scrub").max = message.ticks * message.dt;
  if (another) { buildRoster($("roster").tBodies[0], state, choose); fillHelp($("help"), SWITCHES, message.source === "replay"); }
  link(message.source === "replay" ? "replay" : "live", false);
}

function picture(data) {
  const length = new DataView(data).getUint32(0, true), frame = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  frame.bytes = new Uint8Array(data, 4 + length);
  state.frames += 1;
  count(frame.messages);
  for (const one of frame.happenings) state.happenings.set(one[0], one);
  if (!state.frame || frame.time !== state.frame.time) remember(frame);
  state.frame = frame;
  if (frame.over && !over) { over = true; link("the run is over", true); }
  else if (!frame.over && !frame.play) link(frame.advice ? `live; ${frame.advice}` : "live", Boolean(frame.advice));
  append(state.history, frame.score, state.rate);
  schedule();
}

// Messages per second of wall time, over the last one and a half.
function count(messages) {
  const now = performance.now(), counted = state.counted;
  if (counted.length && messages < counted[counted.length - 1][1]) counted.length = 0;
  counted.push([now, messages]);
  while (counted.length > 2 && counted[0][0] < now - RATE_WINDOW) counted.shift();
  const [then, before] = counted[0];
  state.rate = now - then > 300 ? (1000 * (messages - before)) / (now - then) : null;
}

function remember(frame) {
  const add = (ways, key, x, y) => {
    let way = ways.get(key);
    if (!way) ways.set(key, (way = []));
    if (way.length && way[way.length - 3] >= frame.time) return;
    way.push(frame.time, x, y);
    if (way.length > 1200) way.splice(0, 600);
  };
  for (const agent of frame.agents) if (agent.pose) add(state.trails.bodies, agent.name, agent.pose[0], agent.pose[1]);
  frame.ids.forEach((id, index) => add(state.trails.targets, String(id), frame.targets[2 * index], frame.targets[2 * index + 1]));
  if (state.trails.targets.size > 3 * frame.ids.length + 50) {
    for (const [id, way] of state.trails.targets) if (way[way.length - 3] < frame.time - 20) state.trails.targets.delete(id);
  }
}

// ---------------------------------------------------------------- drawing
let waiting = false;
function schedule(all = false) {
  if (all) tableAt = 0;
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; draw(); });
}

function draw() {
  if (!state.hello) return;
  arena.draw();
  if (!state.frame) return;
  const { frame, hello } = state, now = performance.now();
  $("waiting").textContent = frame.waiting ?? "";
  $("waiting").hidden = !frame.waiting;
  $("clock").textContent = frame.tick < 0 ? "starting" : `${frame.time.toFixed(1)} of ${(hello.ticks * hello.dt).toFixed(0)} s · tick ${frame.tick}`;
  if (frame.play) play(frame.play, frame.time);
  if (now - tableAt > TABLE_PERIOD) {
    tableAt = now;
    fillFigures($("figures"), state);
    fillRoster($("roster").tBodies[0], state);
    fillLog($("log"), state);
    if (state.chosen) fillBelief($("belief"), state);
    for (const [canvas, chart] of charts) drawChart(canvas, chart, state);
    drawStrip($("strip"), state);
  }
}

function link(words, off) { $("link").textContent = words; $("link").classList.toggle("off", off); }

let answerTimer = 0;
function answer(words, ok) {
  $("answer").textContent = words;
  $("answer").className = ok ? "" : "bad";
  $("answer").hidden = !words;
  clearTimeout(answerTimer);
  answerTimer = setTimeout(() => { $("answer").hidden = true; }, 4000);
}

// ---------------------------------------------------------------- choosing an agent
async function look() {
  if (!state.chosen) return;
  const name = state.chosen;
  try {
    const found = await (await fetch(`/api/agent/${encodeURIComponent(name)}`)).json();
    if (state.chosen === name) { state.belief = found; schedule(true); }
  } catch { /* the socket says that the connection is gone */ }
}
setInterval(look, BELIEF_PERIOD);

function choose(name) {
  state.chosen = state.chosen === name ? null : name;
  state.belief = null;
  if (state.chosen) { buildBelief($("belief"), state, act, () => choose(state.chosen)); look(); }
  else $("belief").hidden = true;
  const row = state.chosen && $(`row-${state.chosen}`);
  if (row) row.scrollIntoView({ block: "nearest" });
  schedule(true);
}

function step(by) {
  const names = [...state.order.keys()], at = state.chosen ? state.order.get(state.chosen) + by : by > 0 ? 0 : -1;
  const next = names[(at + names.length) % names.length];
  if (next !== state.chosen) choose(next);
}

function send(request) { if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(request)); }
function act(verb, who) { send({ verb, who }); }

// ---------------------------------------------------------------- replay
function play(now, time) {
  $("play").textContent = now.playing ? "pause" : "play";
  $("play").setAttribute("aria-pressed", String(now.playing));
  if (!scrubbing) $("scrub").value = time;
  if (document.activeElement !== $("speed")) $("speed").value = String(now.speed);
}
function seek(to) { if (state.hello && state.hello.source === "replay") send({ seek: to }); }
let wanted = null;
$("scrub").addEventListener("input", () => {
  scrubbing = true;
  if (wanted === null) setTimeout(() => { seek(wanted); wanted = null; }, 80);
  wanted = Number($("scrub").value);
});
$("scrub").addEventListener("change", () => { scrubbing = false; });
$("play").addEventListener("click", () => send({ play: !(state.frame && state.frame.play && state.frame.play.playing) }));
$("speed").addEventListener("change", () => send({ speed: Number($("speed").value) }));

// ---------------------------------------------------------------- switches, theme, keys
for (const [key, name, words] of SWITCHES) {
  const button = element("button", { type: "button", id: `switch-${name}`, "aria-pressed": "true", title: `${words} (${key})` }, name, element("kbd", {}, key));
  button.addEventListener("click", () => flip(name));
  $("switches").append(button);
}
function flip(name) {
  state.on[name] = !state.on[name];
  $(`switch-${name}`).setAttribute("aria-pressed", String(state.on[name]));
  schedule();
}
function theme() {
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme === "light" ? "dark" : "light";
  try { localStorage.setItem("covey-theme", root.dataset.theme); } catch { /* not kept */ }
  fillLegend($("legend"));
  if (state.hello) { buildRoster($("roster").tBodies[0], state, choose); fillHelp($("help"), SWITCHES, state.hello.source === "replay"); }
  if (state.chosen) buildBelief($("belief"), state, act, () => choose(state.chosen));
  schedule(true);
}
function help() { $("help").hidden = !$("help").hidden; $("helper").setAttribute("aria-expanded", String(!$("help").hidden)); }
$("theme").addEventListener("click", theme);
$("helper").addEventListener("click", help);
$("arena").addEventListener("click", (event) => { const name = arena.at(event); if (name) choose(name); else if (state.chosen) choose(state.chosen); });
new ResizeObserver(() => schedule(true)).observe($("frame"));

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || ["INPUT", "SELECT"].includes(event.target.tagName)) return;
  const found = SWITCHES.find(([key]) => key === event.key), speeds = [...$("speed").options].map((one) => Number(one.value)), replay = state.hello && state.hello.source === "replay";
  const faster = (by) => send({ speed: speeds[Math.max(0, Math.min(speeds.length - 1, speeds.indexOf(state.frame.play.speed) + by))] });
  if (found) flip(found[1]);
  else if (event.key === "x") theme();
  else if (event.key === "?") help();
  else if (event.key === "Escape") { if (!$("help").hidden) help(); else if (state.chosen) choose(state.chosen); }
  else if (event.key === "ArrowRight" || event.key === "ArrowLeft") { step(event.key === "ArrowRight" ? 1 : -1); event.preventDefault(); }
  else if (replay && event.key === " " && event.target.tagName !== "BUTTON") { $("play").click(); event.preventDefault(); }
  else if (replay && event.key === ",") seek(state.frame.time - 1);
  else if (replay && event.key === ".") seek(state.frame.time + 1);
  else if (replay && event.key === "<") faster(-1);
  else if (replay && event.key === ">") faster(1);
});

buildFigures($("figures"));
fillLegend($("legend"));
fillHelp($("help"), SWITCHES, false);
connect();
