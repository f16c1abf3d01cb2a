// What can be kept of the page: an address of this second, a picture, a film.
import { css } from "./palette.js";

// The address of the moment; it stands in the address bar as well.
export function address(state) {
  const words = new URLSearchParams({ t: (state.frame.play && state.frame.play.clock !== undefined ? state.frame.play.clock : state.frame.time).toFixed(2), ...(state.chosen ? { agent: state.chosen } : {}) });
  history.replaceState(null, "", `?${words}`);
  return location.href;
}

// What an address asks for: {time or null, agent or null}.
export function asked() {
  const words = new URLSearchParams(location.search), time = parseFloat(words.get("t"));
  return { time: Number.isFinite(time) ? time : null, agent: words.get("agent") };
}

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const fileName = (state, kind) => `${state.hello.run}-${state.frame.time.toFixed(1)}s.${kind}`;

// Several canvases side by side on one ground.
function together(canvases, target = document.createElement("canvas")) {
  const width = canvases.reduce((sum, canvas) => sum + canvas.width, 0), height = Math.max(...canvases.map((canvas) => canvas.height));
  if (target.width !== width || target.height !== height) { target.width = width; target.height = height; }
  const pen = target.getContext("2d");
  pen.fillStyle = css("back");
  pen.fillRect(0, 0, width, height);
  let left = 0;
  for (const canvas of canvases) { pen.drawImage(canvas, left, 0); left += canvas.width; }
  return target;
}

export function picture(canvases, state) {
  together(canvases).toBlob((blob) => save(blob, fileName(state, "png")), "image/png");
}

// A film of the canvases, from `begin` to `end`; `draw` after each frame.
export class Film {
  begin(canvases) {
    this.canvases = canvases;
    this.target = together(canvases);
    this.parts = [];
    this.recorder = new MediaRecorder(this.target.captureStream(15), { mimeType: "video/webm" });
    this.recorder.ondataavailable = ({ data }) => this.parts.push(data);
    this.recorder.start(200);
    this.timer = setInterval(() => this.draw(), 100); // a film goes on while nothing moves
  }

  get begun() { return this.parts.some((part) => part.size > 0); } // there is something to save

  get running() { return Boolean(this.recorder); }

  draw() { if (this.running) together(this.canvases, this.target); }

  end(state) {
    const name = fileName(state, "webm");
    this.recorder.onstop = () => save(new Blob(this.parts, { type: "video/webm" }), name);
    clearInterval(this.timer);
    this.recorder.stop();
    this.recorder = null;
  }
}
