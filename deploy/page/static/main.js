// The page: one socket, one state, one drawing per frame.
import { Arena } from "./arena.js";
import { append, CHARTS, drawChart, drawStrip, fresh, timeAt } from "./curves.js";
import { element } from "./element.js";
import { Hint } from "./hint.js";
import { address, asked, Film, picture as savePicture } from "./keep.js";
import { keys } from "./keyboard.js";
import { fillLegend } from "./legend.js";
import { fillLog } from "./log.js";
import { buildBelief, buildFigures, buildRoster, fillBelief, fillFigures, fillHelp, fillRoster } from "./panels.js";
import { Player } from "./player.js";
import { pointAt } from "./pointer.js";
import { Scene } from "./scene.js";
import { tellCutoff } from "./texts.js";
import { Tour } from "./tour.js";
import { attach, View } from "./view.js";

const $ = (id) => document.getElementById(id);
const SWITCHES = [["c", "cells", "cells"], ["p", "density", "density"], ["f", "footprints", "footprints"], ["o", "cods", "centroids of detection"], ["d", "detections", "detections"],
  ["t", "truth", "true targets"], ["e", "estimates", "estimates"], ["r", "trails", "trails"], ["n", "names", "names"], ["b", "belief", "the belief of the chosen agent"],
  ["s", "staleness", "staleness"], ["g", "gossip", "gossip on links"]];
const RATE_WINDOW = 1500, BELIEF_PERIOD = 400, TABLE_PERIOD = 300; // ms
const PAUSE = 700, MOST_PAUSE = 10000; // ms from a lost connection to the next try; it grows until a frame has come

const state = {
  hello: null, frame: null, scene: new Scene(), history: fresh(), happenings: new Map(), outlines: {}, order: new Map(),
  on: Object.fromEntries(SWITCHES.map(([, name]) => [name, name !== "gossip"])), chosen: null, pointed: null, belief: null, rate: null, counted: [], frames: 0,
  told: null, readout: null, held: false, linked: false, film: new Film(), send,
};
window.covey = state; // for the curious, for tests and benchmarks
let waiting = false, tableAt = 0, tableTimer = 0; // of the next drawing, and of the tables
const besides = new Scene(), view = (state.view = new View(moved));
const arenas = [new Arena($("arena"), state, state.scene, view), new Arena($("beside"), state, besides, view)];
const hint = new Hint($("hint")), tour = new Tour($("tour")), player = new Player($, state), { film } = state;
const charts = CHARTS.map((chart) => {
  const canvas = element("canvas", { role: "img", tabindex: "0", "aria-label": `curve of ${chart.title}`, "data-hint": chart.hint });
  $("charts").append(element("figure", {}, canvas));
  canvas.addEventListener("click", (event) => player.seek(timeAt(canvas, event.offsetX, state.hello)));
  canvas.addEventListener("pointermove", (event) => { if (state.hello) readAt(timeAt(canvas, event.offsetX, state.hello)); });
  canvas.addEventListener("pointerleave", () => readAt(null));
  canvas.addEventListener("blur", () => readAt(null));
  return [canvas, chart];
});
let socket = null, pause = PAUSE, over = false, left = false, missed = null, seen = null; // missed: the newest frame, until it is shown; seen: the frame of the belief

// ---------------------------------------------------------------- what arrives
function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? text(JSON.parse(data)) : arrived(data));
  socket.onclose = () => {
    state.linked = false;
    link();
    schedule(true);
    setTimeout(connect, over || left ? 3000 : pause);
    pause = Math.min(2 * pause, MOST_PAUSE);
  };
}

function text(message) {
  if (message.type === "hello") hello(message);
  else if (message.type === "answer") answer(message.text, message.ok);
  else if (message.type === "bye") { state.linked = false; if (state.hello?.source === "live") over = true; else left = true; link(); }
}

function hello(message) {
  const another = !state.hello || state.hello.run !== message.run || state.hello.agents.length !== message.agents.length;
  state.hello = message;
  state.linked = true;
  tellCutoff(message.cutoff);
  over = left = false;
  state.history = fresh({ ...message.curves, beside: message.beside && message.beside.ospa });
  state.happenings = new Map(message.happenings.map((one) => [one[0], one]));
  state.outlines = Object.fromEntries(message.agents.map((agent) => [agent.name, agent.outline]));
  state.order = new Map(message.agents.map((agent, index) => [agent.name, index]));
  state.scene.begin(message, message.trails);
  besides.begin(message, { bodies: {}, targets: {} });
  const names = message.beside ? message.beside.names : ["", ""];
  const what = message.beside ? `${names[0]} (left) beside ${names[1]}` : `${message.partition} diagram`;
  $("title").textContent = `${message.run}: ${message.scenario.split("/").pop()}, ${message.agents.length} agents, ${what}, seed ${message.seed}`;
  $("title").title = $("title").textContent;
  document.title = `${message.run} – Covey`;
  $("beside").hidden = !message.beside;
  arenas.forEach((arena, index) => { arena.title = names[index]; });
  if (message.beside) $("beside").setAttribute("aria-label", `The same run with ${names[1]}, from above`);
  document.body.classList.toggle("compares", Boolean(message.beside));
  const [mine, other] = names.map((name) => name.split(", ")[0]); // the arenas say the whole of it
  CHARTS[0].lines = message.beside ? [["ospa", mine], ["beside", other]] : [["ospa", ""]];
  player.begin(message);
  $("hold").hidden = player.plays;
  charts[charts.length - 1][0].parentElement.hidden = message.source !== "live"; // how fast messages came is a matter of the live run
  if (another) begin();
  link();
  if (another && message.tour) tour.offer();
  if (another && state.order.has(asked().agent) && !state.chosen) choose(asked().agent);
}

// Another run, or one with other agents: nobody of the former is chosen, and nothing of it is held.
function begin() {
  if (state.chosen && !state.order.has(state.chosen)) choose(state.chosen);
  missed = null;
  if (state.held) hold();
  view.reset();
  buildRoster($("roster").tBodies[0], state, choose);
  fillHelp($("help"), SWITCHES, player);
}

function arrived(data) {
  const length = new DataView(data).getUint32(0, true), frame = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const squares = frame.grid[0] * frame.grid[1];
  frame.bytes = new Uint8Array(data, 4 + length, squares);
  state.frames += 1;
  pause = PAUSE;
  count(frame.messages);
  for (const one of frame.happenings) state.happenings.set(one[0], one);
  append(state.history, frame.score, state.rate, frame.beside && frame.beside.score ? frame.beside.score[1] : null);
  if (frame.beside) frame.beside.bytes = new Uint8Array(data, 4 + length + squares);
  missed = frame;
  catchUp();
}

// Show the newest frame. It waits while the picture is held or out of sight: no other may come after it.
function catchUp() {
  const frame = missed;
  if (!frame || state.held || document.hidden) return;
  missed = null;
  state.scene.take(frame);
  if (frame.beside) besides.take(frame.beside);
  state.frame = frame;
  over = Boolean(frame.over);
  link();
  schedule();
}
document.addEventListener("visibilitychange", catchUp);

// Messages per second of wall time, over the last one and a half.
function count(messages) {
  const now = performance.now(), counted = state.counted;
  if (counted.length && messages < counted[counted.length - 1][1]) counted.length = 0;
  counted.push([now, messages]);
  while (counted.length > 2 && counted[0][0] < now - RATE_WINDOW) counted.shift();
  const [then, before] = counted[0];
  state.rate = now - then > 300 ? (1000 * (messages - before)) / (now - then) : null;
}

// ---------------------------------------------------------------- drawing
// A finger scrolls the page while the whole arena is seen, and moves the arena otherwise.
function moved() {
  for (const id of ["arena", "beside"]) $(id).style.touchAction = state.view && state.view.moved ? "none" : "pan-y";
  schedule();
}

function schedule(all = false) {
  if (all) tableAt = 0;
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; draw(); });
}

function draw() {
  if (!state.hello) return;
  if (state.frame) tell();
  for (const arena of shown()) arena.draw();
  for (const look of looks) look();
}

function tell() {
  const { frame, hello } = state, now = performance.now();
  $("waiting").textContent = frame.waiting ?? "";
  $("waiting").hidden = !frame.waiting;
  $("clock").textContent = frame.tick < 0 ? "starting" : `${frame.time.toFixed(1)} of ${(hello.ticks * hello.dt).toFixed(0)} s · tick ${frame.tick}`;
  if (frame.play) player.show(frame.play, frame.time);
  clearTimeout(tableTimer);
  if (now - tableAt > TABLE_PERIOD) { tableAt = now; fill(); }
  else tableTimer = setTimeout(() => schedule(true), TABLE_PERIOD); // the last frame before a pause is told whole
}

function fill() {
  fillFigures($("figures"), state);
  fillRoster($("roster").tBodies[0], state);
  fillLog($("log"), state);
  fillLegend($("legend"), state);
  if (state.chosen) fillBelief($("belief"), state);
  for (const [canvas, chart] of charts) if (!canvas.parentElement.hidden) drawChart(canvas, chart, state);
  drawStrip($("strip"), state);
  tour.place();
  state.told = state.frame; // the legend takes its room by what a frame holds: from here on nothing moves
}

const shown = () => (state.hello && state.hello.beside ? arenas : arenas.slice(0, 1));

function readAt(time) {
  if (time === state.readout) return;
  state.readout = time === null ? null : Math.min(time, state.frame ? Math.max(state.frame.time, state.history.time.at(-1) ?? 0) : time);
  schedule(true);
}

// What the run and the connection are like.
function link() {
  const { frame, hello, linked, held } = state, usual = hello ? hello.source : "", advice = frame && frame.advice ? `${usual}; ${frame.advice}` : usual;
  const words = over ? "the run is over" : left ? "the server has ended" : !linked ? "no connection; trying again" : held ? "held; Space goes on" : advice;
  if ($("link").textContent === words) return;
  $("link").textContent = words;
  $("link").classList.toggle("off", words !== usual);
}

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
  if (!state.chosen || !state.linked || state.held || (state.belief && state.frame === seen)) return;
  const name = state.chosen;
  seen = state.frame;
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
  if (row) show(row, $("team"));
  schedule(true);
}

// Scroll a row into sight within its list, and leave the page where it is.
function show(row, list) {
  const { top, bottom } = row.getBoundingClientRect(), box = list.getBoundingClientRect(), head = row.offsetHeight;
  list.scrollTop += Math.min(0, top - head - box.top) + Math.max(0, bottom - box.bottom);
}

function step(by) {
  const names = [...state.order.keys()], at = state.chosen ? state.order.get(state.chosen) + by : by > 0 ? 0 : -1;
  const next = names[(at + names.length) % names.length];
  if (next !== state.chosen) choose(next);
}

function send(request) { if (state.linked) socket.send(JSON.stringify(request)); else answer("There is no connection, so nothing was sent.", false); }
function act(verb, who) { send({ verb, who }); }

// Where the page may move targets (a comparison), one under the pointer follows it.
function dragged(arena, event) {
  const found = state.hello.drags ? arena.under(event) : null;
  if (!found || found.kind !== "target") return null;
  const number = arena.scene.frame.ids[found.index], most = state.hello.arena;
  let at = 0;
  return (place, last) => {
    if (!last && performance.now() - at < 80) return;
    at = performance.now();
    send({ drag: number, to: place.map((value, axis) => Math.max(0, Math.min(most[axis], value))) });
  };
}

// ---------------------------------------------------------------- switches, tools, keys
for (const [key, name, words] of SWITCHES) {
  const button = element("button", { type: "button", id: `switch-${name}`, "aria-pressed": String(state.on[name]), "data-hint": name === "cods" ? "centroids" : name, "aria-label": `${words} (${key})` },
    name === "cods" ? "CODs" : name, element("kbd", {}, key));
  button.addEventListener("click", () => flip(name));
  $("switches").append(button);
}
function flip(name) {
  state.on[name] = !state.on[name];
  $(`switch-${name}`).setAttribute("aria-pressed", String(state.on[name]));
  schedule(true);
}
function theme() {
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme === "light" ? "dark" : "light";
  try { localStorage.setItem("covey-theme", root.dataset.theme); } catch { /* not kept */ }
  if (state.hello) { buildRoster($("roster").tBodies[0], state, choose); fillHelp($("help"), SWITCHES, player); }
  if (state.chosen) buildBelief($("belief"), state, act, () => choose(state.chosen));
  schedule(true);
}
function help() { $("help").hidden = !$("help").hidden; $("helper").setAttribute("aria-expanded", String(!$("help").hidden)); }

// Close what is open, the newest first; then choose nobody; then show the whole arena.
function escape() {
  if (tour.running) tour.end();
  else if (!$("help").hidden) help();
  else if (hint.visible) { hint.hide(); readAt(null); }
  else if (state.chosen) choose(state.chosen);
  else view.reset();
}

// A live swarm goes on; the picture waits.
function hold() {
  state.held = !state.held;
  $("hold").setAttribute("aria-pressed", String(state.held));
  $("hold").textContent = state.held ? "go on" : "hold";
  link();
  catchUp();
}

async function share() {
  const here = address(state);
  let copied = "stands in the address bar";
  try { await navigator.clipboard.writeText(here); copied = "is copied"; } catch { /* no clipboard here */ }
  answer(state.hello.source === "replay" ? `The address of this second ${copied}.` : `The address of this second ${copied}. It opens there while covey replay ${state.hello.run} serves it.`, true);
}

function filming() {
  if (film.running) film.end(state);
  else film.begin(shown().map((arena) => arena.canvas));
  $("film").setAttribute("aria-pressed", String(film.running));
  $("film").textContent = film.running ? "stop" : "GIF";
}

$("address").addEventListener("click", share);
$("png").addEventListener("click", () => { arenas[0].draw(); savePicture(shown().map((arena) => arena.canvas), state); });
$("film").addEventListener("click", filming);
$("hold").addEventListener("click", hold);
$("guide").addEventListener("click", (event) => { event.stopPropagation(); hint.hide(); tour.go(0); });
$("theme").addEventListener("click", theme);
$("helper").addEventListener("click", help);
for (const arena of arenas) attach(arena, view, (event) => dragged(arena, event));
const looks = arenas.map((arena) => pointAt(arena, state, hint, schedule, choose)); // who looks again after a drawing
new ResizeObserver(() => schedule(true)).observe($("frame"));
keys({ state, view, player, switches: SWITCHES, flip, theme, help, escape, hold, step, readAt, charts: charts.map(([canvas]) => canvas) });

buildFigures($("figures"));
fillHelp($("help"), SWITCHES, player);
connect();
