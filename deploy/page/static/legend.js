// The legend: what is drawn right now, and nothing else.
import { element } from "./element.js";
import { css, marks, owner, schemeName } from "./palette.js";
import { cross, disc, diamond, arrow, bars } from "./shapes.js";

// A name, its hint, when it is drawn, and how it looks in a square of 32 px.
const ITEMS = [
  ["true target", "truth", ({ on, frame }) => on.truth && frame.targets.length, (c) => { c.strokeStyle = marks().truth; c.lineWidth = 3; c.arc(16, 16, 10, 0, 7); c.stroke(); }],
  ["estimate", "estimates", ({ on, has }) => on.estimates && has((agent) => agent.targets && agent.targets.length), (c) => disc(c, 16, 16, 7, marks().estimate, css("field"), 2)],
  ["detection", "detections", ({ on, has }) => on.detections && has((agent) => agent.seen && agent.seen.length), (c) => { c.fillStyle = marks().seen; c.fillRect(12, 12, 8, 8); }],
  ["expected targets (PHD)", "density", ({ on }) => on.density, (c) => { const g = c.createRadialGradient(16, 16, 1, 16, 16, 15), rgb = marks().density.join(","); g.addColorStop(0, `rgba(${rgb},1)`); g.addColorStop(1, `rgba(${rgb},0)`); c.fillStyle = g; c.fillRect(0, 0, 32, 32); }],
  ["agent", "agent", ({ has }) => has((agent) => agent.pose && agent.state !== "dead" && agent.state !== "waiting"), (c) => arrow(c, 14, 16, 0, 11, owner(2), css("field"), 2)],
  ["footprint", "footprints", ({ on }) => on.footprints, (c) => { c.strokeStyle = owner(2); c.lineWidth = 2; c.strokeRect(5, 8, 22, 16); }],
  ["centre of its view (COD)", "centroids", ({ on, has }) => on.cods && has((agent) => agent.cod && agent.state !== "dead"), (c) => diamond(c, 16, 16, 9, owner(2))],
  ["trail of an agent, a target, a track", "trails", ({ on }) => on.trails, (c) => { c.strokeStyle = owner(2); c.lineWidth = 2; c.moveTo(2, 26); c.quadraticCurveTo(16, 4, 30, 12); c.stroke(); }],
  ["dead", "dead", ({ has }) => has((agent) => agent.state === "dead" && agent.pose), (c) => { arrow(c, 14, 16, 0, 11, marks().gone, css("field"), 2); cross(c, 16, 16, 10, css("ink"), 4); }],
  ["paused", "state", ({ has }) => has((agent) => agent.state === "paused"), (c) => bars(c, 16, 16, 10, css("warn"), 4)],
  ["link", "gossip", ({ on }) => on.gossip, (c) => { c.strokeStyle = css("soft"); c.setLineDash([6, 4]); c.lineWidth = 3; c.moveTo(2, 16); c.lineTo(30, 16); c.stroke(); }],
  ["stale", "staleness", ({ on, has }) => on.staleness && has((agent) => agent.state === "silent" || agent.state === "paused"), (c) => { c.fillStyle = css("warn"); c.globalAlpha = 0.5; c.fillRect(5, 5, 22, 22); }],
  ["its particles, cell, estimates", "belief", ({ on, chosen }) => on.belief && chosen, (c) => { c.strokeStyle = css("ink"); c.setLineDash([5, 4]); c.lineWidth = 2; c.strokeRect(4, 4, 24, 24); c.fillStyle = css("ink"); c.fillRect(14, 14, 4, 4); }],
  ["its claim", "claim", ({ on, chosen }) => on.belief && chosen, (c) => { c.strokeStyle = css("ink"); c.lineWidth = 2; c.arc(16, 16, 11, 0, 7); c.stroke(); c.fillStyle = css("ink"); c.fillRect(14, 14, 4, 4); }],
];

export function fillLegend(list, state) {
  if (!state.frame) return;
  const has = (test) => state.frame.agents.some(test), now = { on: state.on, frame: state.frame, chosen: has((agent) => agent.name === state.chosen && agent.state !== "dead"), has };
  const shown = ITEMS.filter(([, , when]) => when(now)), stamp = `${document.documentElement.dataset.theme} ${state.on.cells} ${shown.map(([name]) => name)}`;
  if (list.dataset.stamp === stamp) return;
  list.dataset.stamp = stamp;
  list.replaceChildren(...shown.map(([name, hint, , draw]) => {
    const canvas = element("canvas", { width: "32", height: "32", "aria-hidden": "true" });
    draw(canvas.getContext("2d"));
    return element("li", { "data-hint": hint, tabindex: "0" }, canvas, name);
  }), ...(state.on.cells ? [element("li", { "data-hint": "cells", tabindex: "0" }, `cells: touching ones differ in colour (${schemeName()})`)] : []));
}
