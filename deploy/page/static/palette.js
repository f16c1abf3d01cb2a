// Colours. Owners wear Paul Tol's "muted" scheme on light ground and his "light" scheme on dark ground; both keep apart for colour-blind
// eyes, and nothing is told by colour alone: bodies and cells carry names, kinds of marks have shapes.
export const MUTED = ["#332288", "#44aa99", "#cc6677", "#117733", "#88ccee", "#882255", "#999933", "#aa4499", "#ddaa33"];
export const LIGHT = ["#77aadd", "#ee8866", "#44bb99", "#eedd88", "#ffaabb", "#99ddff", "#bbcc33", "#c9a4e0", "#aaaa00"];

export const OWNERS = 9; // colours of a scheme

const theme = () => document.documentElement.dataset.theme;
export const isLight = () => theme() === "light";
export const schemeName = () => (isLight() ? "Paul Tol's “muted”" : "Paul Tol's “light”");

export function owner(index) {
  const colours = isLight() ? MUTED : LIGHT;
  return colours[index % colours.length];
}

const read = new Map(); // the browser is slow to say what a variable is: ask once per theme

export function css(name) {
  const key = `${theme()} ${name}`;
  if (!read.has(key)) read.set(key, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return read.get(key);
}

// Colours of marks, by theme: true targets, estimates, detections, density (red, green, blue).
export function marks() {
  return isLight()
    ? { truth: "#111a22", estimate: "#d4380d", seen: "#00558c", density: [20, 50, 110], gone: "#98a3ae" }
    : { truth: "#ffffff", estimate: "#ffb000", seen: "#9bd7ff", density: [255, 214, 120], gone: "#6b7886" };
}

export function alpha(hex, share) {
  return hex + Math.round(255 * share).toString(16).padStart(2, "0");
}

export const GLYPHS = { lost: "✕", back: "▲", joined: "▲", twin: "⚠", silent: "◌", paused: "‖", heard: "●", asked: "☞", told: "→", partition: "≠", heal: "=", links: "≈", world: "■" };
