// The arena from above: density, cells, footprints, bodies, detections, targets, estimates, trails, and one agent's belief.
import { alpha, css, isLight, marks, owner } from "./palette.js";
import { arrow, bars, cross, diamond, disc, room } from "./shapes.js";
import { short } from "./texts.js";

const RING = 6, LONGEST_NAME = 24; // radius of a true target, px; letters

export class Arena {
  constructor(canvas, state, scene, view) {
    this.canvas = canvas;
    this.state = state;
    this.scene = scene;
    this.view = view;
    this.density = document.createElement("canvas");
    this.scale = 1;
    this.title = ""; // of one of two arenas: what its swarm differs in
  }

  // The colour of an agent's cell, by its place in the team.
  owner(index) { return owner(this.scene.colours[index] ?? index); }

  // Pixels of a place in metres.
  x(east) { return this.left + east * this.scale; }
  y(north) { return this.top - north * this.scale; }

  fit() {
    const ratio = Math.min(2, window.devicePixelRatio || 1), box = this.canvas.getBoundingClientRect();
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    const [east, north] = this.state.hello.arena, margin = 14 * ratio;
    this.ratio = ratio;
    this.scale = this.view.zoom * Math.min((width - 2 * margin) / east, (height - 2 * margin) / north);
    this.left = width / 2 - this.view.east * east * this.scale;
    this.top = height / 2 + this.view.north * north * this.scale;
    this.unit = ratio * Math.max(1, Math.min(1.6, Math.min(width, height) / ratio / 700));
  }

  draw() {
    const { hello, on, chosen } = this.state, frame = (this.frame = this.scene.frame);
    if (!hello) return;
    this.fit();
    const c = (this.pen = this.canvas.getContext("2d"));
    this.ink = css("ink");
    this.mark = marks();
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.ground();
    if (!frame) return;
    this.small = this.unit * room(frame.targets, RING * this.unit, this.scale);
    c.save();
    c.beginPath();
    c.rect(this.x(0), this.y(hello.arena[1]), hello.arena[0] * this.scale, hello.arena[1] * this.scale);
    c.save();
    c.clip();
    if (on.cells) frame.agents.forEach((agent, index) => this.cell(agent, index));
    if (on.cells) this.scene.fading.forEach((one) => this.fade(one));
    if (on.staleness) frame.agents.forEach((agent) => this.stale(agent));
    if (on.density) this.heat();
    if (on.footprints) frame.agents.forEach((agent, index) => this.footprint(agent, index));
    c.restore();
    if (on.gossip) this.gossip();
    if (this.state.pointed) this.neighbours(this.state.pointed);
    if (on.trails) this.trails();
    if (on.detections) frame.agents.forEach((agent) => this.detections(agent));
    if (on.belief && chosen && this.state.belief && this.scene === this.state.scene) this.belief(this.state.belief);
    if (on.cods) frame.agents.forEach((agent, index) => this.cod(agent, index));
    if (on.truth) this.targets();
    if (on.estimates) frame.agents.forEach((agent) => this.estimates(agent.targets));
    frame.agents.forEach((agent, index) => this.body(agent, index));
    const headline = this.title ? [this.headline()] : [];
    if (on.names) this.names(headline);
    c.restore();
  }

  ground() {
    const c = this.pen, [east, north] = this.state.hello.arena;
    c.fillStyle = css("field");
    c.fillRect(this.x(0), this.y(north), east * this.scale, north * this.scale);
    const least = Math.max(east, north) / 11, power = 10 ** Math.floor(Math.log10(least)), step = power * [1, 2, 5, 10].find((size) => size * power >= least);
    c.strokeStyle = css("grid");
    c.lineWidth = this.ratio;
    c.beginPath();
    for (let at = step; at < east; at += step) { c.moveTo(this.x(at), this.y(0)); c.lineTo(this.x(at), this.y(north)); }
    for (let at = step; at < north; at += step) { c.moveTo(this.x(0), this.y(at)); c.lineTo(this.x(east), this.y(at)); }
    c.stroke();
    c.strokeStyle = css("soft");
    c.strokeRect(this.x(0), this.y(north), east * this.scale, north * this.scale);
    c.fillStyle = css("soft");
    c.font = `${10.5 * this.unit}px system-ui, sans-serif`;
    c.textAlign = "left";
    c.textBaseline = "alphabetic";
    const bar = step * this.scale;
    c.fillRect(this.x(0), this.y(0) + 5 * this.ratio, bar, 2 * this.ratio);
    c.fillText(step < 1000 ? `${step} m` : `${step / 1000} km`, this.x(0) + bar + 5 * this.ratio, this.y(0) + 10 * this.ratio);
  }

  path(flat) {
    const c = this.pen;
    c.beginPath();
    for (let i = 0; i < flat.length; i += 2) i ? c.lineTo(this.x(flat[i]), this.y(flat[i + 1])) : c.moveTo(this.x(flat[0]), this.y(flat[1]));
    c.closePath();
  }

  cell(agent, index) {
    if (!agent.cell || !agent.cell.length) return;
    const c = this.pen, { chosen } = this.state, mine = chosen === agent.name || this.state.pointed === agent.name;
    this.path(agent.cell);
    c.fillStyle = alpha(this.owner(index), (mine ? 0.38 : chosen ? 0.1 : 0.2) * (isLight() ? 1.15 : 1));
    c.fill();
    c.strokeStyle = alpha(this.owner(index), mine ? 1 : 0.75);
    c.lineWidth = (mine ? 2.6 : 1.1) * this.ratio;
    c.stroke();
  }

  heat() {
    const { grid, bytes } = this.frame;
    if (!bytes || !grid) return;
    const [columns, rows, square] = grid, [red, green, blue] = this.mark.density;
    if (this.density.width !== columns || this.density.height !== rows) { this.density.width = columns; this.density.height = rows; }
    const pen = this.density.getContext("2d"), image = pen.createImageData(columns, rows), data = image.data;
    for (let row = 0; row < rows; row++) {
      let at = 4 * (rows - 1 - row) * columns, from = row * columns;
      for (let column = 0; column < columns; column++, at += 4, from++) {
        data[at] = red; data[at + 1] = green; data[at + 2] = blue; data[at + 3] = bytes[from];
      }
    }
    pen.putImageData(image, 0, 0);
    const c = this.pen;
    c.globalAlpha = this.state.chosen ? 0.35 : 0.9;
    c.imageSmoothingEnabled = true;
    c.drawImage(this.density, this.x(0), this.y(rows * square), columns * square * this.scale, rows * square * this.scale);
    c.globalAlpha = 1;
  }

  footprint(agent, index) {
    const outline = this.state.outlines[agent.name];
    if (!agent.pose || !outline || !outline.length || agent.state === "dead" || agent.state === "waiting") return;
    const c = this.pen, [east, north, heading] = agent.pose, cos = Math.cos(heading), sin = Math.sin(heading);
    c.beginPath();
    for (let i = 0; i < outline.length; i += 2) {
      const px = this.x(east + outline[i] * cos - outline[i + 1] * sin), py = this.y(north + outline[i] * sin + outline[i + 1] * cos);
      i ? c.lineTo(px, py) : c.moveTo(px, py);
    }
    c.closePath();
    const mine = this.state.chosen === agent.name, quiet = agent.state !== "alive" && agent.state !== "listening";
    c.fillStyle = alpha(quiet ? this.mark.gone : this.owner(index), mine ? 0.2 : 0.07);
    c.fill();
    c.setLineDash(quiet ? [4 * this.ratio, 4 * this.ratio] : []);
    c.strokeStyle = alpha(quiet ? this.mark.gone : this.owner(index), this.state.chosen && !mine ? 0.3 : 0.6);
    c.lineWidth = (mine ? 2 : 0.9) * this.ratio;
    c.stroke();
    c.setLineDash([]);
  }

  trails() {
    const { trails } = this.scene, { frame } = this;
    frame.agents.forEach((agent, index) => {
      const way = trails.bodies.get(agent.name);
      if (way) this.way(way, agent.state === "dead" ? this.mark.gone : this.owner(index), 1.3, 0.55);
    });
    if (this.state.on.truth) for (const way of trails.targets.values()) this.way(way, this.mark.truth, 1, 0.3);
    if (this.state.on.estimates) for (const way of trails.labels.values()) this.way(way, this.mark.estimate, 1.4, 0.7, 0.5 * this.state.hello.cutoff);
  }

  // A line through points in time; it is broken where they are more than `most` m apart, or some seconds: nothing was seen between.
  way(points, colour, width, share, most = Infinity) {
    const c = this.pen, now = this.frame.time, { fade, trail } = this.scene;
    c.strokeStyle = alpha(colour, share);
    c.lineWidth = width * this.ratio;
    c.beginPath();
    let drawn = false;
    for (let i = 0; i < points.length; i += 3) {
      if (points[i] < now - trail || points[i] > now) continue;
      const px = this.x(points[i + 1]), py = this.y(points[i + 2]);
      const near = drawn && points[i] - points[i - 3] <= fade && Math.hypot(points[i + 1] - points[i - 2], points[i + 2] - points[i - 1]) <= most;
      near ? c.lineTo(px, py) : c.moveTo(px, py);
      drawn = true;
    }
    c.stroke();
  }

  detections(agent) {
    if (!agent.seen) return;
    const c = this.pen, size = 1.5 * this.unit;
    c.fillStyle = this.mark.seen;
    for (let i = 0; i < agent.seen.length; i += 2) c.fillRect(this.x(agent.seen[i]) - size, this.y(agent.seen[i + 1]) - size, 2 * size, 2 * size);
  }

  cod(agent, index) {
    if (!agent.cod || !agent.pose || agent.state === "dead") return;
    const c = this.pen, px = this.x(agent.cod[0]), py = this.y(agent.cod[1]), size = 3.2 * this.unit;
    c.strokeStyle = alpha(this.owner(index), 0.85);
    c.lineWidth = 1.1 * this.ratio;
    c.beginPath();
    c.moveTo(this.x(agent.pose[0]), this.y(agent.pose[1]));
    c.lineTo(px, py);
    c.stroke();
    diamond(c, px, py, size, this.owner(index));
  }

  targets() {
    const c = this.pen, { targets } = this.frame, size = RING * this.small;
    for (const [colour, width] of [[css("field"), 1.8 + (2.2 * this.small) / this.unit], [this.mark.truth, 1.8]]) {
      c.strokeStyle = colour;
      c.lineWidth = width * this.ratio;
      for (let i = 0; i < targets.length; i += 2) {
        c.beginPath();
        c.arc(this.x(targets[i]), this.y(targets[i + 1]), size, 0, 7);
        c.stroke();
      }
    }
  }

  // A dot: in the ring of a true target when that was found.
  estimates(flat, colour = this.mark.estimate) {
    if (!flat) return;
    for (let i = 0; i < flat.length; i += 2) disc(this.pen, this.x(flat[i]), this.y(flat[i + 1]), 3.4 * this.small, colour, css("field"), (1.2 * this.ratio * this.small) / this.unit);
  }

  body(agent, index) {
    if (!agent.pose || agent.state === "waiting") return;
    const c = this.pen, [east, north, heading] = agent.pose, px = this.x(east), py = this.y(north), size = 6.5 * this.unit;
    const dead = agent.state === "dead", still = dead || agent.state === "paused" || agent.state === "silent";
    arrow(c, px, py, heading, size, still ? this.mark.gone : this.owner(index), css("field"), 1.5 * this.ratio);
    if (dead || agent.state === "paused") this.badge(px, py, size, dead);
    if (this.state.chosen === agent.name) this.ring(px, py, 1.9 * size, css("accent"));
  }

  // A cross on the dead, two bars on the paused.
  badge(px, py, size, dead) { (dead ? cross : bars)(this.pen, px, py, 0.95 * size, dead ? this.ink : css("warn"), 2.2 * this.ratio); }

  ring(px, py, radius, colour) {
    const c = this.pen;
    c.strokeStyle = colour;
    c.lineWidth = 1.6 * this.ratio;
    c.beginPath();
    c.arc(px, py, radius, 0, 7);
    c.stroke();
  }

  // Which diagram this is, how large its error is, as the figures say it, and how far it lags where it cannot keep up. Returns the box that the words take.
  headline() {
    const c = this.pen, { told, scene } = this.state, moment = this.scene === scene ? told : told?.beside;
    const error = typeof moment?.score?.[1] === "number" ? `, OSPA ${short(moment.score[1], 2)} m` : "", behind = moment?.time < told?.time ? `, ${(told.time - moment.time).toFixed(1)} s behind` : "";
    c.font = `600 ${13 * this.unit}px system-ui, sans-serif`;
    c.textAlign = "left";
    c.textBaseline = "bottom";
    c.fillStyle = this.ink;
    const words = `${this.title}${error}${behind}`, foot = Math.max(18 * this.unit, this.y(this.state.hello.arena[1]) - 4 * this.ratio);
    c.fillText(words, this.x(0), foot, this.canvas.width - this.x(0)); // narrower where there is no room
    return [this.x(0), foot - 16 * this.unit, c.measureText(words).width, 16 * this.unit];
  }

  // Names above their bodies, or where nothing else is written: below, right or left of them. `taken`: boxes of other words.
  names(taken) {
    const c = this.pen, size = 6.5 * this.unit, high = 10.5 * this.unit;
    c.font = `600 ${high}px system-ui, sans-serif`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    for (const { name, pose, state } of this.frame.agents) {
      if (!pose || state === "waiting") continue;
      const words = name.length > LONGEST_NAME ? `${name.slice(0, LONGEST_NAME - 1)}…` : name;
      const px = this.x(pose[0]), py = this.y(pose[1]), wide = c.measureText(words).width + 4 * this.ratio, away = size + 0.65 * high, beside = 1.4 * size + wide / 2;
      const boxes = [[0, -away], [0, away], [beside, 0], [-beside, 0]].map(([right, down]) => [px + right - wide / 2, py + down - high / 2, wide, high]);
      const box = boxes.find((one) => this.isFree(one, taken)) || [Math.max(0, Math.min(this.canvas.width - wide, boxes[0][0])), ...boxes[0].slice(1)];
      taken.push(box);
      this.name(words, box[0] + wide / 2, box[1] + high / 2, state === "dead");
    }
  }

  // Whether a box (left, top, width, height) lies on the canvas and touches no other.
  isFree([left, top, wide, high], taken) {
    if (left < 0 || top < 0 || left + wide > this.canvas.width || top + high > this.canvas.height) return false;
    return taken.every(([x, y, w, h]) => left + wide < x || x + w < left || top + high < y || y + h < top);
  }

  name(text, px, py, dead) {
    const c = this.pen;
    c.strokeStyle = alpha(css("field"), 0.85);
    c.lineWidth = 3 * this.ratio;
    c.lineJoin = "round";
    c.strokeText(text, px, py);
    c.fillStyle = dead ? this.mark.gone : this.ink;
    c.fillText(text, px, py);
  }

  // The cell of one that has died, fading into those of its heirs.
  fade({ index, cell, time }) {
    const c = this.pen, share = Math.max(0, 1 - (this.frame.time - time) / this.scene.fade);
    this.path(cell);
    c.fillStyle = alpha(this.owner(index), 0.45 * share);
    c.fill();
    c.setLineDash([6 * this.ratio, 4 * this.ratio]);
    c.strokeStyle = alpha(css("warn"), share);
    c.lineWidth = 1.8 * this.ratio;
    c.stroke();
    c.setLineDash([]);
  }

  // A cell turns red as the last message of its agent grows old.
  stale(agent) {
    const share = Math.min(1, (agent.age || 0) / this.state.hello.silent);
    if (share < 0.15 || !agent.cell || !agent.cell.length) return;
    this.path(agent.cell);
    this.pen.fillStyle = alpha(css("warn"), 0.45 * share);
    this.pen.fill();
  }

  // Links between neighbours: dashes that move on with each thing said.
  gossip() {
    const c = this.pen, step = 9 * this.ratio, poses = new Map(this.frame.agents.map((agent) => [agent.name, agent.pose]));
    c.lineWidth = 1.4 * this.ratio;
    c.setLineDash([0.45 * step, 0.55 * step]);
    this.frame.agents.forEach((agent, index) => {
      const said = this.scene.said.get(agent.name);
      if (!agent.pose || !agent.neighbours || agent.state === "dead" || !said) return;
      c.lineDashOffset = -0.3 * step * said.count;
      c.strokeStyle = alpha(said.fresh ? this.owner(index) : this.mark.gone, said.fresh ? 0.85 : 0.5);
      c.beginPath();
      for (const name of agent.neighbours) if (poses.get(name)) this.line(agent.pose, poses.get(name));
      c.stroke();
    });
    c.setLineDash([]);
    c.lineDashOffset = 0;
  }

  line(from, to) { this.pen.moveTo(this.x(from[0]), this.y(from[1])); this.pen.lineTo(this.x(to[0]), this.y(to[1])); }

  // The cells of those that bound the cell under the pointer.
  neighbours(name) {
    const c = this.pen, agent = this.scene.agent(name);
    if (!agent || !agent.neighbours) return;
    this.frame.agents.forEach((other, index) => {
      if (!agent.neighbours.includes(other.name) || !other.cell || !other.cell.length) return;
      this.path(other.cell);
      c.strokeStyle = this.owner(index);
      c.lineWidth = 2.6 * this.ratio;
      c.setLineDash([7 * this.ratio, 3 * this.ratio]);
      c.stroke();
    });
    c.setLineDash([]);
  }

  // What the chosen agent believes, from its own messages: its particles, its cell, its estimates, and the generators of its claim.
  belief(belief) {
    const c = this.pen, size = 1.1 * this.unit, dots = belief.particles || [];
    if (belief.state === "dead") return;
    c.fillStyle = alpha(this.ink, 0.75);
    for (let i = 0; i < dots.length; i += 2) c.fillRect(this.x(dots[i]) - size, this.y(dots[i + 1]) - size, 2 * size, 2 * size);
    c.setLineDash([5 * this.ratio, 4 * this.ratio]);
    c.strokeStyle = this.ink;
    if (belief.cell && belief.cell.length) { this.path(belief.cell); c.lineWidth = 2 * this.ratio; c.stroke(); }
    const [mine, ...others] = belief.claim || [];
    c.lineWidth = 1.2 * this.ratio;
    c.beginPath();
    for (const other of others) this.line(mine.at, other.at);
    c.stroke();
    c.setLineDash([]);
    for (const one of belief.claim || []) this.ring(this.x(one.at[0]), this.y(one.at[1]), Math.max(2, one.radius * this.scale), alpha(this.owner(this.state.order.get(one.name) ?? 0), 0.9));
    const found = belief.targets || [];
    for (let i = 0; i < found.length; i += 2) this.ring(this.x(found[i]), this.y(found[i + 1]), 8.5 * this.small, this.mark.estimate);
  }

  // The place under a pointer, m.
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [((event.clientX - box.left) * this.ratio - this.left) / this.scale, (this.top - (event.clientY - box.top) * this.ratio) / this.scale];
  }

  // Width and height of the arena on the screen, px.
  span() { const [east, north] = this.state.hello.arena; return [(east * this.scale) / this.ratio, (north * this.scale) / this.ratio]; }

  // What is under a pointer: {kind: agent, target, estimate, cell; name or index}, or null. Bodies come before marks, marks before cells.
  under(event) {
    const frame = this.scene.frame;
    if (!frame || !this.pen) return null;
    const [east, north] = this.place(event), reach = (event.pointerType === "touch" ? 22 : 13) * this.unit / this.scale;
    let found = null, least = reach;
    const look = (x, y, what) => { const far = Math.hypot(x - east, y - north); if (far < least) { least = far; found = what; } };
    for (const agent of frame.agents) if (agent.pose && agent.state !== "waiting") look(agent.pose[0], agent.pose[1], { kind: "agent", name: agent.name });
    if (found) return found;
    if (this.state.on.truth) for (let i = 0; i < frame.targets.length; i += 2) look(frame.targets[i], frame.targets[i + 1], { kind: "target", index: i / 2 });
    if (this.state.on.estimates) for (const { name, targets } of frame.agents) for (let i = 0; targets && i < targets.length; i += 2) look(targets[i], targets[i + 1], { kind: found && found.kind === "target" ? "target" : "estimate", name, index: found && found.kind === "target" ? found.index : i / 2 });
    if (found) return found;
    for (const agent of frame.agents) if (agent.cell && inside(agent.cell, east, north)) return { kind: "cell", name: agent.name };
    return null;
  }
}

// Whether a place lies in a polygon.
function inside(cell, x, y) {
  let within = false;
  for (let i = 0, j = cell.length - 2; i < cell.length; j = i, i += 2) {
    if (cell[i + 1] > y !== cell[j + 1] > y && x < ((cell[j] - cell[i]) * (y - cell[i + 1])) / (cell[j + 1] - cell[i + 1]) + cell[i]) within = !within;
  }
  return within;
}
