// One swarm from frame to frame: its newest frame, the trails, the colours of its cells, and the cells of those that have just died.
import { colouring } from "./colouring.js";
import { OWNERS } from "./palette.js";

const MOST = 1200; // numbers kept of a trail, three a point
const FADE = 4, TRAIL = 12; // s of the world in which a dead agent's cell fades, and that trails last; or so many ticks, where these are longer:
const FADE_TICKS = 8, TRAIL_TICKS = 24;

export class Scene {
  constructor() { this.clear(); }

  clear() {
    this.frame = null;
    this.trails = { bodies: new Map(), targets: new Map(), labels: new Map() };
    this.cells = new Map(); // the last of each living agent
    this.fading = []; // {index, cell, time} of the dead
    this.said = new Map(); // the tick of each agent's newest gossip; how often it has said something; whether since the frame before
    this.colours = [];
  }

  // What a newcomer is told.
  begin(hello, trails) {
    this.fade = Math.max(FADE, FADE_TICKS * hello.dt);
    this.trail = Math.max(TRAIL, TRAIL_TICKS * hello.dt);
    this.trails.bodies = new Map(Object.entries(trails.bodies));
    this.trails.targets = new Map(Object.entries(trails.targets));
    if (this.colours.length !== hello.agents.length) this.colours = hello.agents.map((_, index) => index % OWNERS);
  }

  take(frame) {
    const last = this.frame;
    if (last && (frame.time < last.time || frame.time > last.time + this.fade)) { this.fading = []; this.cells.clear(); }
    if (last && frame.time < last.time) this.trails.labels.clear();
    if (!last || frame.time !== last.time) { this.remember(frame); this.bury(frame); }
    for (const agent of frame.agents) this.hear(agent);
    this.frame = frame;
    if (this.colours.length === frame.agents.length) this.colours = colouring(frame.agents.map((agent) => agent.cell || []), this.colours, OWNERS);
  }

  hear(agent) {
    const before = this.said.get(agent.name), fresh = agent.said !== undefined && (!before || agent.said !== before.tick);
    this.said.set(agent.name, { tick: agent.said, count: (before ? before.count : 0) + (fresh ? 1 : 0), fresh });
  }

  remember(frame) {
    for (const agent of frame.agents) {
      if (agent.pose) add(this.trails.bodies, agent.name, frame.time, agent.pose[0], agent.pose[1]);
      if (agent.labels) agent.labels.forEach((label, index) => label && add(this.trails.labels, String(label), frame.time, agent.targets[2 * index], agent.targets[2 * index + 1]));
    }
    frame.ids.forEach((id, index) => add(this.trails.targets, String(id), frame.time, frame.targets[2 * index], frame.targets[2 * index + 1]));
    for (const ways of [this.trails.targets, this.trails.labels]) {
      if (ways.size <= 3 * frame.ids.length + 50) continue;
      for (const [id, way] of ways) if (way[way.length - 3] < frame.time - this.trail) ways.delete(id);
    }
  }

  // The cell of an agent that is dead since the frame before.
  bury(frame) {
    this.fading = this.fading.filter((one) => frame.time < one.time + this.fade);
    frame.agents.forEach((agent, index) => {
      if (agent.cell && agent.cell.length) this.cells.set(agent.name, agent.cell);
      else if (agent.state === "dead" && this.cells.has(agent.name)) {
        this.fading.push({ index, cell: this.cells.get(agent.name), time: frame.time });
        this.cells.delete(agent.name);
      }
    });
  }

  agent(name) { return this.frame && this.frame.agents.find((one) => one.name === name); }
}

function add(ways, key, time, x, y) {
  let way = ways.get(key);
  if (!way) ways.set(key, (way = []));
  if (way.length && way[way.length - 3] >= time) return;
  way.push(time, x, y);
  if (way.length > MOST) way.splice(0, MOST / 2);
}
