// What can be kept of the page: an address of this second, a picture, a film.
import { Gif } from "./gif.js";
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

const STEP = 0.1, WIDE = 720; // s between two frames of a film; px, its greatest width

// A film of the canvases as a GIF, from `begin` to `end`. It goes on while nothing moves.
export class Film {
  begin(canvases) {
    const target = document.createElement("canvas"), whole = together(canvases), share = Math.min(1, WIDE / whole.width);
    target.width = Math.round(whole.width * share);
    target.height = Math.round(whole.height * share);
    const pen = target.getContext("2d", { willReadFrequently: true });
    this.gif = new Gif(target.width, target.height);
    const take = () => {
      pen.drawImage(together(canvases, whole), 0, 0, target.width, target.height);
      this.gif.add(pen.getImageData(0, 0, target.width, target.height).data, STEP);
    };
    take();
    this.timer = setInterval(take, 1000 * STEP);
  }

  get running() { return Boolean(this.gif); }

  end(state) {
    clearInterval(this.timer);
    save(this.gif.blob(), fileName(state, "gif"));
    this.gif = null;
  }
}
