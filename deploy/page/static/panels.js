// Tables and texts beside the arena. Cells are written only when their text has changed.
import { element } from "./element.js";
import { owner, schemeName } from "./palette.js";
import { short } from "./texts.js";

const set = (node, text) => { if (node.textContent !== text) node.textContent = text; };
const figure = (value, digits) => (value === undefined || value === null ? "" : short(value, digits));

// ---------------------------------------------------------------- figures
const FIGURES = ["OSPA", "GOSPA", "targets", "in cells", "alive", "hole", "overlap", "messages", "ticks", "skipped"];

export function buildFigures(box) {
  box.replaceChildren(...FIGURES.map((name) => element("button", { type: "button", id: `figure-${name.replace(" ", "-")}`, "data-hint": name }, element("b"), element("span", {}, name))));
}

export function fillFigures(box, state) {
  const { frame, rate } = state, score = frame.score, alive = frame.agents.filter((agent) => !["dead", "waiting"].includes(agent.state)).length;
  const values = score
    ? [[short(score[1], 2), "m"], [short(score[2], 1), "m"], [`${score[4]} of ${short(score[3], 0)}`, ""], [short(score[5], 1), "mass"]]
    : [["–", ""], ["–", ""], ["–", ""], ["–", ""]];
  values.push([`${alive} of ${frame.agents.length}`, ""], [score ? short(100 * score[6], 2) : "–", "%"], [score ? short(100 * score[7], 2) : "–", "%"]);
  values.push([rate === null ? "–" : rate.toFixed(0), "/s"]);
  const [done, asked, skipped, late] = frame.tick_rate || [null, null, 0, 0];
  values.push([done === null ? "–" : done.toFixed(1), asked === null ? "/s" : `of ${asked} /s`], [String(skipped), late ? `rounds, ${late} late` : "rounds"]);
  values.forEach(([value, unit], index) => {
    const b = box.children[index].firstChild;
    if (b.dataset.text === value + unit) return;
    b.dataset.text = value + unit;
    b.replaceChildren(value, element("small", {}, unit));
  });
  box.children[4].classList.toggle("bad", alive < frame.agents.length);
  box.children[5].classList.toggle("bad", Boolean(score) && score[6] > 0.001);
  box.children[6].classList.toggle("bad", Boolean(score) && score[7] > 0.001);
  for (const at of [7, 8, 9]) box.children[at].hidden = !frame.tick_rate; // a replay has no pace of its own
  box.children[9].classList.toggle("bad", skipped > 0);
}

// ---------------------------------------------------------------- roster
export function buildRoster(body, state, choose) {
  body.replaceChildren(...state.hello.agents.map((agent, index) => {
    const colour = element("i"), button = element("button", { type: "button", title: `${agent.name}, class ${agent.class}` }, colour, agent.name, element("small", {}, agent.class));
    colour.style.background = owner(state.scene.colours[index] ?? index);
    const row = element("tr", { id: `row-${agent.name}` }, element("th", { scope: "row" }, button), ...Array.from({ length: 9 }, () => element("td")));
    row.addEventListener("click", () => choose(agent.name));
    return row;
  }));
}

export function fillRoster(body, state) {
  state.frame.agents.forEach((agent, index) => {
    const row = body.children[index];
    if (!row) return;
    const name = agent.state + (state.chosen === agent.name ? " chosen" : "");
    if (row.className !== name) row.className = name;
    const dot = row.querySelector("i"), colour = owner(state.scene.colours[index] ?? index);
    if (dot.dataset.colour !== colour) { dot.dataset.colour = colour; dot.style.background = colour; }
    const cells = row.children, gone = agent.state === "dead";
    set(cells[1], agent.state + (agent.incarnation > 1 && agent.incarnation < 1000 ? ` ·${agent.incarnation}` : ""));
    const values = gone ? Array(5).fill("") : [figure(agent.unused, 1), figure(agent.radius, 2), figure(agent.load, 2), figure(agent.mass, 2), figure(agent.ms, 1)];
    values.forEach((value, at) => set(cells[2 + at], value));
    set(cells[7], agent.age === null ? "" : agent.age.toFixed(agent.age < 10 ? 2 : 0));
    set(cells[8], agent.rejected ? String(agent.rejected) : "");
    set(cells[9], agent.skipped ? String(agent.skipped) : "");
  });
}

// ---------------------------------------------------------------- one agent
const TELLS = { kill: "Kill", pause: "Pause", resume: "Resume", restart: "Restart", partition: "Partition", heal: "Heal all" };

export function buildBelief(box, state, act, close) {
  const index = state.order.get(state.chosen) ?? 0, dot = element("i"), shut = element("button", { type: "button", title: "Close (Esc)" }, "close");
  dot.style.background = owner(state.scene.colours[index] ?? index);
  shut.addEventListener("click", close);
  const acts = element("div", { class: "acts" });
  for (const verb of state.hello.verbs || []) {
    const button = element("button", { type: "button", class: verb, "data-verb": verb }, TELLS[verb] || verb);
    button.addEventListener("click", () => act(verb, verb === "heal" ? "" : state.chosen));
    acts.append(button);
  }
  box.replaceChildren(element("h2", {}, dot, state.chosen, element("span", { id: "belief-state" }), shut), element("p", { id: "belief-cell" }), element("p", { id: "belief-neighbours", "data-hint": "neighbours" }), element("p", { id: "belief-counters", "data-hint": "counters" }), acts);
  box.hidden = false;
}

export function fillBelief(box, state) {
  const { belief } = state, agent = state.frame && state.frame.agents.find((one) => one.name === state.chosen);
  if (!agent) return;
  for (const button of box.querySelectorAll("[data-verb]")) {
    const verb = button.dataset.verb, dead = agent.state === "dead" || agent.state === "waiting", paused = agent.state === "paused";
    button.disabled = state.frame.over || !state.linked || { kill: dead, pause: dead || paused, resume: !paused, restart: !dead, partition: dead }[verb] || false;
  }
  if (!belief) return;
  box.querySelector("h2 i").style.background = owner(state.scene.colours[state.order.get(state.chosen)] ?? 0);
  set(box.querySelector("#belief-state"), `class ${belief.class || "?"}, ${agent.state}${belief.listening ? ", listening" : ""}`);
  const particles = belief.particles ? belief.particles.length / 2 : 0, targets = belief.targets ? belief.targets.length / 2 : 0;
  const gone = agent.state === "dead", [is, holds, reports, sees] = gone ? ["was", "Held", "reported", "saw"] : ["is", "Holds", "reports", "sees"];
  set(box.querySelector("#belief-cell"), belief.mass === undefined ? "It has not spoken yet." :
    `${holds} ${short(belief.mass, 2)} expected targets in ${particles} particles, ${reports} ${targets}; ${sees} ${(belief.detections || []).length / 2} detections; U = ${short(belief.unused, 1)} m².`);
  const agree = belief.agree ? ` Its diagram ${is} that of ${belief.agree[0]} of ${belief.agree[1]} who spoke of tick ${belief.tick}.` : "";
  set(box.querySelector("#belief-neighbours"), belief.neighbours ? `${belief.neighbours.length ? `Its cell ${is} bounded by ${belief.neighbours.join(", ")}.` : agent.cell && agent.cell.length ? "Its cell is the whole arena." : gone ? "It has no cell." : "It has no cell now: the cells of others cover its place."}${agree}` : "");
  set(box.querySelector("#belief-counters"), Object.entries(belief.counters || {}).map(([name, count]) => `${name} ${count}`).join("  ·  "));
}

// ---------------------------------------------------------------- help
export function fillHelp(box, switches, { plays, seeks }) {
  const keys = [["click, ↑ ↓", "choose an agent: what it believes is drawn over the arena"], ["Esc", "close what is open; choose nobody; see the whole arena"],
    ["space", plays ? "play or pause" : "hold the picture, or go on; the swarm goes on all the time"],
    ["← →", seeks ? "one second back or on (Shift: ten)" : "choose an agent"],
    ["wheel, + −", "zoom; two fingers do the same"], ["drag, Shift + arrows", "move the arena"], ["double click, 0", "the whole arena"],
    ...switches.map(([key, , text]) => [key, `${text} on or off`]), ["x", "dark or light"], ["?", "this page"]];
  if (plays) keys.push(["< >", "slower or faster"]);
  const list = element("dl");
  for (const [key, text] of keys) list.append(element("dt", {}, key), element("dd", {}, text));
  box.replaceChildren(element("h2", {}, "Keys"), list, element("h2", {}, "Colours"),
    element("p", {}, `Owners: ${schemeName()} scheme; curves: Okabe and Ito. Both are made for colour-blind eyes, and every mark has a shape or a name of its own.`));
}
