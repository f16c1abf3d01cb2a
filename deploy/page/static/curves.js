// Curves over the world's time, and the strip of what happened. Each chart is one canvas: lines, a scale, and the newest values.
import { alpha, css, GLYPHS, isLight } from "./palette.js";
import { short } from "./texts.js";

const MOST = 2400; // points kept of a curve; beyond that one of each two goes
export const NAMES = ["time", "ospa", "gospa", "targets", "estimated", "mass", "hole", "overlap", "rate", "beside"];

// Line colours of the charts (Okabe and Ito), by theme, and a dash for each so that they differ without colour as well.
const LINES = { dark: ["#56b4e9", "#e69f00", "#cccccc"], light: ["#0072b2", "#c05a00", "#555555"] };
const DASHES = [[], [5, 3], [1.5, 2.5]];

export const CHARTS = [
  { hint: "OSPA", title: "OSPA", unit: "m", lines: [["ospa", ""]], digits: 2 },
  { hint: "GOSPA", title: "GOSPA", unit: "m", lines: [["gospa", ""]], digits: 1 },
  { hint: "targets", title: "targets", unit: "", lines: [["targets", "true"], ["estimated", "estimated"], ["mass", "mass"]], digits: 1 },
  { hint: "hole", title: "hole, overlap", unit: "%", lines: [["hole", "hole"], ["overlap", "overlap"]], digits: 2, times: 100, least: 0.5 },
  { hint: "messages", title: "messages", unit: "/s", lines: [["rate", ""]], digits: 0 },
];

export function fresh(curves) {
  const history = {};
  for (const name of NAMES) history[name] = (curves && curves[name] ? curves[name] : []).slice();
  for (const name of ["rate", "beside"]) while (history[name].length < history.time.length) history[name].push(null);
  return history;
}

export function append(history, score, rate, beside = null) {
  const last = history.time.length - 1;
  if (!score || (last >= 0 && score[0] <= history.time[last])) return;
  score.forEach((value, index) => history[NAMES[index]].push(value));
  history.rate.push(rate);
  history.beside.push(beside);
  if (history.time.length > MOST) thin(history);
}

// Keep one of each two points: that with the larger hole and overlap, for these come and go within a tick.
function thin(history) {
  const torn = (index) => history.hole[index] + history.overlap[index];
  const kept = [];
  for (let i = 0; i < history.time.length; i += 2) kept.push(torn(i + 1) > torn(i) ? i + 1 : i);
  for (const name of NAMES) history[name] = kept.map((index) => history[name][index]);
}

function prepare(canvas) {
  const ratio = Math.min(2, window.devicePixelRatio || 1), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, width, height);
  return [pen, width, height, ratio];
}

const GUTTER = 3; // root font sizes: the room for the scale, left of the curves

const fontSize = () => parseFloat(getComputedStyle(document.documentElement).fontSize); // px

// The world's time at a place on a chart, s; 0 left of the curves.
export function timeAt(canvas, offset, hello) {
  const left = GUTTER * fontSize();
  return Math.max(0, ((offset - left) / (canvas.clientWidth - left)) * hello.ticks * hello.dt);
}

// A round number at or above a value, for the top of a scale.
function top(value) {
  const size = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 3, 4, 5, 7.5, 10].map((step) => step * size).find((step) => step >= value * 0.9999);
}

// Where in the curves a time stands: the last point of this time or before; -1 before the first.
export function indexAt(times, time) {
  let low = 0, high = times.length;
  while (low < high) { const middle = (low + high) >> 1; times[middle] <= time ? (low = middle + 1) : (high = middle); }
  return low - 1;
}

export function drawChart(canvas, chart, state) {
  const [pen, width, height, ratio] = prepare(canvas), { history, hello, frame } = state;
  const em = fontSize() * ratio, head = 1.45 * em, foot = 3 * ratio, left = GUTTER * em, times = chart.times || 1;
  const seconds = hello.ticks * hello.dt, x = (time) => left + (time / seconds) * (width - left);
  let most = chart.least || 0;
  for (const [name] of chart.lines) for (const value of history[name]) if (value !== null && times * value > most) most = times * value;
  most = most > 0 ? top(most) : 1;
  const y = (value) => height - foot - (times * value / most) * (height - head - foot);
  pen.strokeStyle = css("line");
  pen.lineWidth = ratio;
  pen.beginPath();
  for (const share of [0, 0.5, 1]) { const at = Math.round(y(share * most / times)) + 0.5; pen.moveTo(left, at); pen.lineTo(width, at); }
  pen.stroke();
  faultLines(pen, state, x, head, height);
  const colours = isLight() ? LINES.light : LINES.dark;
  chart.lines.forEach(([name], index) => line(pen, history.time, history[name], x, y, colours[index], DASHES[index].map((part) => part * ratio), ratio));
  if (frame && frame.play) { pen.fillStyle = css("accent"); pen.fillRect(x(frame.time), head, 1.5 * ratio, height); }
  if (state.readout !== null) { pen.fillStyle = css("ink"); pen.fillRect(x(state.readout), head, ratio, height); }
  scale(pen, chart, most, y(most / times), y(0), left, em);
  label(pen, chart, state, colours, width, em);
}

function faultLines(pen, state, x, head, height) {
  pen.fillStyle = alpha(css("warn"), 0.55);
  for (const [, time, kind] of state.happenings.values()) if (kind === "lost" || kind === "partition") pen.fillRect(x(time), head, 1, height - head);
}

function line(pen, times, values, x, y, colour, dash, ratio) {
  pen.strokeStyle = colour;
  pen.lineWidth = 1.6 * ratio;
  pen.lineJoin = "round";
  pen.setLineDash(dash);
  pen.beginPath();
  let drawn = false;
  for (let i = 0; i < times.length; i++) {
    if (values[i] === null) continue;
    drawn ? pen.lineTo(x(times[i]), y(values[i])) : pen.moveTo(x(times[i]), y(values[i]));
    drawn = true;
  }
  pen.stroke();
  pen.setLineDash([]);
}

// The ends of the scale, in the gutter beside their lines.
function scale(pen, chart, most, high, low, left, em) {
  pen.fillStyle = css("soft");
  pen.font = `${0.82 * em}px system-ui, "DejaVu Sans", sans-serif`;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  pen.fillText(`${most}${chart.unit === "%" ? " %" : ""}`, left - 0.4 * em, high + 0.1 * em);
  pen.textBaseline = "alphabetic";
  pen.fillText("0", left - 0.4 * em, low);
}

function label(pen, chart, state, colours, width, em) {
  const { frame, history } = state, times = chart.times || 1, reads = state.readout !== null, last = reads ? indexAt(history.time, state.readout) : history.time.length - 1;
  pen.font = `${0.86 * em}px system-ui, "DejaVu Sans", sans-serif`;
  pen.textBaseline = "alphabetic";
  let at = width;
  pen.textAlign = "right";
  chart.lines.map(([name, words], index) => [name, words, index]).reverse().forEach(([name, words, index]) => {
    const now = !reads && frame && frame.score && NAMES.indexOf(name) < frame.score.length ? frame.score[NAMES.indexOf(name)] : history[name][last];
    const text = `${words ? `${words} ` : ""}${now === undefined || now === null ? "–" : short(times * now, chart.digits)}`;
    pen.fillStyle = colours[index];
    pen.fillText(text, at, 0.92 * em);
    at -= pen.measureText(text).width + 0.3 * em;
    if (words) {
      pen.strokeStyle = colours[index];
      pen.setLineDash(DASHES[index].map((part) => (part * em) / 13));
      pen.beginPath();
      pen.moveTo(at - 1.3 * em, 0.62 * em);
      pen.lineTo(at, 0.62 * em);
      pen.stroke();
      pen.setLineDash([]);
      at -= 2 * em;
    }
  });
  const title = chart.title + (chart.unit && !chart.lines[0][1] ? `, ${chart.unit}` : ""), moment = reads ? `${state.readout.toFixed(1)} s` : "";
  pen.textAlign = "left";
  pen.fillStyle = css("soft");
  const words = [[title, moment].filter(Boolean).join(" at "), moment || title].find((one) => pen.measureText(one).width < at);
  if (words) pen.fillText(words, 0, 0.92 * em);
}

// The whole run as a strip: what happened, as marks with shapes, and where we are.
export function drawStrip(canvas, state) {
  const [pen, width, height, ratio] = prepare(canvas), { hello, frame, happenings } = state;
  const seconds = hello.ticks * hello.dt, em = fontSize() * ratio;
  const x = (time) => 0.5 * em + (time / seconds) * (width - em), middle = 0.36 * height;
  pen.fillStyle = css("line");
  pen.fillRect(x(0), middle - 2 * ratio, x(seconds) - x(0), 4 * ratio);
  if (frame) { pen.fillStyle = css("accent"); pen.fillRect(x(0), middle - 2 * ratio, x(frame.time) - x(0), 4 * ratio); }
  pen.font = `${0.82 * em}px system-ui, "DejaVu Sans", sans-serif`;
  pen.fillStyle = css("soft");
  pen.textBaseline = "alphabetic";
  pen.textAlign = "left";
  const step = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600].find((size) => seconds / size <= Math.min(12, width / (4 * em))) || seconds / 10;
  for (let time = 0; time <= seconds + 1e-9; time += step) {
    const words = `${Math.round(time)} s`, half = pen.measureText(words).width / 2;
    pen.fillText(words, Math.max(x(0), Math.min(x(seconds) - 2 * half, x(time) - half)), height - 2 * ratio);
  }
  pen.font = `700 ${0.86 * em}px system-ui, "DejaVu Sans", sans-serif`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const [time, kind] of apart([...happenings.values()], (0.8 * em * seconds) / (width - em))) {
    pen.fillStyle = { lost: css("warn"), twin: css("warn"), silent: css("warn"), paused: css("warn"), partition: css("warn"), links: css("warn"), world: css("soft"), asked: css("accent") }[kind] || css("good");
    pen.fillText(GLYPHS[kind] || "•", x(time), middle);
  }
}

const FIRST = ["lost", "partition", "heal", "links", "back", "joined", "twin", "world", "paused", "silent", "heard", "asked", "told"]; // which mark stands where two would

// The marks of some happenings as [time, kind], at least so many s apart: what weighs most keeps its place.
export function apart(happenings, least) {
  const kept = [];
  for (const kind of FIRST) for (const [, time, its] of happenings) if (its === kind && kept.every(([other]) => Math.abs(other - time) >= least)) kept.push([time, kind]);
  return kept;
}
