// What happened, as sentences, the newest first. What befalls several agents at once is one sentence, and your own commands are kept.
import { element } from "./element.js";
import { GLYPHS } from "./palette.js";

const TOGETHER = 1.0, MOST = 40; // s of the world; sentences
const SAYS = { lost: ["is gone", "are gone"], back: ["is back", "are back"], joined: ["has joined", "have joined"], silent: ["has fallen silent", "have fallen silent"],
  paused: ["is paused", "are paused"], heard: ["is heard again", "are heard again"] };

// Happenings [number, time, kind, who, text] as groups {number, time, kind, names, text}, oldest first.
export function grouped(happenings) {
  const groups = [];
  for (const [number, time, kind, who, text] of happenings) {
    const last = groups.findLast((group) => group.kind === kind && time - group.time <= TOGETHER);
    if (SAYS[kind] && last && !last.names.includes(who)) {
      last.names.push(who);
      last.number = number;
      last.text = `${listed(last.names)} ${SAYS[kind][1]}`;
    } else groups.push({ number, time, kind, names: [who], text });
  }
  return groups;
}

export function listed(names) {
  return names.length < 2 ? names.join("") : `${names.slice(0, -1).join(", ")} and ${names[names.length - 1]}`;
}

export function fillLog(list, state) {
  const past = [...state.happenings.values()].filter(([, time]) => !state.frame.play || time <= state.frame.time); // a replay knows the future
  const groups = grouped(past), shown = groups.filter((group, index) => group.kind === "asked" || index >= groups.length - MOST).reverse();
  const stamp = shown.map((group) => group.number).join();
  if (list.dataset.stamp === stamp) return;
  list.dataset.stamp = stamp;
  const line = ({ time, kind, text }) => element("li", { class: kind }, element("time", {}, `${time.toFixed(1)} s`), element("i", { "aria-hidden": "true" }, GLYPHS[kind] || "•"), ` ${text}`);
  list.replaceChildren(...(shown.length ? shown.map(line) : [element("li", { class: "none" }, "Nothing has happened yet.")]));
}
