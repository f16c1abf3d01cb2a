// The arena from above: density, cells, footprints, bodies, detections, targets, estimates, trails, and one agent's belief.
import { alpha, css, isLight, marks, owner } from "./palette.js";

const TRAIL = 12; // s

export class Arena {
  constructor(canvas, state) {
    this.canvas = canvas;
    this.state = state;
    this.density = document.createElement("canvas");
    this.scale = 1;
  }

  // Pixels of a place in metres.
  x(east) { return this.left + east * this.scale; }
  y(north) { return this.top - north * this.scale; }

  fit() {
    const ratio = Math.min(2, window.devicePixelRatio || 1), box = this.canvas.getBoundingClientRect();
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) { this.canvas.width = width; this.canvas.height = height; }
    const [east, north] = this.state.hello.arena, margin = 14 * ratio;
    this.ratio = ratio;
    this.scale = Math.min((width - 2 * margin) / east, (height - 2 * margin) / north);
    this.left = (width - east * this.scale) / 2;
    this.top = (height + north * this.scale) / 2;
    this.unit = ratio * Math.max(1, Math.min(1.6, Math.min(width, height) / ratio / 700));
  }

  draw() {
    const { hello, frame, on, chosen } = this.state;
    if (!hello) return;
    this.fit();
    const c = (this.pen = this.canvas.getContext("2d"));
    this.ink = css("ink");
    this.mark = marks();
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.ground();
    if (!frame) return;
    c.save();
    c.beginPath();
    c.rect(this.x(0), this.y(hello.arena[1]), hello.arena[0] * this.scale, hello.arena[1] * this.scale);
    c.save();
    c.clip();
    if (on.cells) frame.agents.forEach((agent, index) => this.cell(agent, index));
    if (on.density) this.heat();
    if (on.footprints) frame.agents.forEach((agent, index) => this.footprint(agent, index));
    c.restore();
    if (on.trails) this.trails();
    if (on.detections) frame.agents.forEach((agent) => this.detections(agent));
    if (chosen && this.state.belief) this.belief();
    if (on.cods) frame.agents.forEach((agent, index) => this.cod(agent, index));
    if (on.truth) this.targets();
    if (on.estimates) frame.agents.forEach((agent) => this.estimates(agent.targets));
    frame.agents.forEach((agent, index) => this.body(agent, index));
    c.restore();
  }

  ground() {
    const c = this.pen, [east, north] = this.state.hello.arena;
    c.fillStyle = css("field");
    c.fillRect(this.x(0), this.y(north), east * this.scale, north * this.scale);
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((size) => Math.max(east, north) / size <= 11) || 5000;
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
    c.fillText(`${step} m`, this.x(0) + bar + 5 * this.ratio, this.y(0) + 10 * this.ratio);
  }

  path(flat) {
    const c = this.pen;
    c.beginPath();
    for (let i = 0; i < flat.length; i += 2) i ? c.lineTo(this.x(flat[i]), this.y(flat[i + 1])) : c.moveTo(this.x(flat[0]), this.y(flat[1]));
    c.closePath();
  }

  cell(agent, index) {
    if (!agent.cell || !agent.cell.length) return;
    const c = this.pen, { chosen } = this.state, mine = chosen === agent.name;
    this.path(agent.cell);
    c.fillStyle = alpha(owner(index), (mine ? 0.38 : chosen ? 0.1 : 0.2) * (isLight() ? 1.15 : 1));
    c.fill();
    c.strokeStyle = alpha(owner(index), mine ? 1 : 0.75);
    c.lineWidth = (mine ? 2.6 : 1.1) * this.ratio;
    c.stroke();
  }

  heat() {
    const { grid, bytes } = this.state.frame;
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
    c.fillStyle = alpha(quiet ? this.mark.gone : owner(index), mine ? 0.2 : 0.07);
    c.fill();
    c.setLineDash(quiet ? [4 * this.ratio, 4 * this.ratio] : []);
    c.strokeStyle = alpha(quiet ? this.mark.gone : owner(index), this.state.chosen && !mine ? 0.3 : 0.6);
    c.lineWidth = (mine ? 2 : 0.9) * this.ratio;
    c.stroke();
    c.setLineDash([]);
  }

  trails() {
    const { trails, frame } = this.state;
    frame.agents.forEach((agent, index) => {
      const way = trails.bodies.get(agent.name);
      if (way) this.way(way, agent.state === "dead" ? this.mark.gone : owner(index), 1.3, 0.55);
    });
    if (this.state.on.truth) for (const way of trails.targets.values()) this.way(way, this.mark.truth, 1, 0.3);
  }

  way(points, colour, width, share) {
    const c = this.pen, now = this.state.frame.time;
    c.strokeStyle = alpha(colour, share);
    c.lineWidth = width * this.ratio;
    c.beginPath();
    let drawn = false;
    for (let i = 0; i < points.length; i += 3) {
      if (points[i] < now - TRAIL || points[i] > now) continue;
      const px = this.x(points[i + 1]), py = this.y(points[i + 2]);
      drawn ? c.lineTo(px, py) : c.moveTo(px, py);
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
    c.strokeStyle = alpha(owner(index), 0.85);
    c.lineWidth = 1.1 * this.ratio;
    c.beginPath();
    c.moveTo(this.x(agent.pose[0]), this.y(agent.pose[1]));
    c.lineTo(px, py);
    c.stroke();
    c.fillStyle = owner(index);
    c.beginPath();
    c.moveTo(px, py - size); c.lineTo(px + size, py); c.lineTo(px, py + size); c.lineTo(px - size, py);
    c.fill();
  }

  targets() {
    const c = this.pen, { targets } = this.state.frame, size = 6 * this.unit;
    for (const [colour, width] of [[css("field"), 4], [this.mark.truth, 1.8]]) {
      c.strokeStyle = colour;
      c.lineWidth = width * this.ratio;
      for (let i = 0; i < targets.length; i += 2) {
        c.beginPath();
        c.arc(this.x(targets[i]), this.y(targets[i + 1]), size, 0, 7);
        c.stroke();
      }
    }
  }

  estimates(flat) {
    if (!flat) return;
    const c = this.pen, size = 3.9 * this.unit;
    for (const [colour, width] of [[css("field"), 4.2], [this.mark.estimate, 2.1]]) {
      c.strokeStyle = colour;
      c.lineWidth = width * this.ratio;
      c.beginPath();
      for (let i = 0; i < flat.length; i += 2) {
        const px = this.x(flat[i]), py = this.y(flat[i + 1]);
        c.moveTo(px - size, py - size); c.lineTo(px + size, py + size);
        c.moveTo(px - size, py + size); c.lineTo(px + size, py - size);
      }
      c.stroke();
    }
  }

  body(agent, index) {
    if (!agent.pose || agent.state === "waiting") return;
    const c = this.pen, [east, north, heading] = agent.pose, px = this.x(east), py = this.y(north), size = 6.5 * this.unit;
    const dead = agent.state === "dead", still = dead || agent.state === "paused" || agent.state === "silent";
    c.save();
    c.translate(px, py);
    c.rotate(-heading);
    c.beginPath();
    c.moveTo(1.25 * size, 0); c.lineTo(-0.8 * size, 0.75 * size); c.lineTo(-0.4 * size, 0); c.lineTo(-0.8 * size, -0.75 * size);
    c.closePath();
    c.fillStyle = still ? this.mark.gone : owner(index);
    c.strokeStyle = css("field");
    c.lineWidth = 1.5 * this.ratio;
    c.fill();
    c.stroke();
    c.restore();
    if (dead || agent.state === "paused") this.badge(px, py, size, dead);
    if (this.state.chosen === agent.name) this.ring(px, py, 1.9 * size, css("accent"));
    if (this.state.on.names) this.name(agent.name, px, py - 1.25 * size, dead);
  }

  // A cross on the dead, two bars on the paused.
  badge(px, py, size, dead) {
    const c = this.pen, s = 0.95 * size;
    c.strokeStyle = css("warn");
    c.lineWidth = 2.2 * this.ratio;
    c.beginPath();
    if (dead) { c.moveTo(px - s, py - s); c.lineTo(px + s, py + s); c.moveTo(px - s, py + s); c.lineTo(px + s, py - s); }
    else { c.moveTo(px - 0.4 * s, py - s); c.lineTo(px - 0.4 * s, py + s); c.moveTo(px + 0.4 * s, py - s); c.lineTo(px + 0.4 * s, py + s); }
    c.stroke();
  }

  ring(px, py, radius, colour) {
    const c = this.pen;
    c.strokeStyle = colour;
    c.lineWidth = 1.6 * this.ratio;
    c.beginPath();
    c.arc(px, py, radius, 0, 7);
    c.stroke();
  }

  name(text, px, py, dead) {
    const c = this.pen;
    c.font = `600 ${10.5 * this.unit}px system-ui, sans-serif`;
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    c.strokeStyle = alpha(css("field"), 0.85);
    c.lineWidth = 3 * this.ratio;
    c.lineJoin = "round";
    c.strokeText(text, px, py);
    c.fillStyle = dead ? this.mark.gone : this.ink;
    c.fillText(text, px, py);
  }

  // What the chosen agent believes: its particles, and the generators that bound its cell, where it places them.
  belief() {
    const c = this.pen, { belief } = this.state;
    if (belief.state === "dead" || !belief.claim) return;
    const size = 1.1 * this.unit;
    c.fillStyle = alpha(this.ink, 0.75);
    const dots = belief.particles || [];
    for (let i = 0; i < dots.length; i += 2) c.fillRect(this.x(dots[i]) - size, this.y(dots[i + 1]) - size, 2 * size, 2 * size);
    if (!belief.claim.length) return;
    const [mine, ...others] = belief.claim;
    c.setLineDash([5 * this.ratio, 4 * this.ratio]);
    for (const other of others) {
      c.strokeStyle = alpha(this.ink, 0.75);
      c.lineWidth = 1.2 * this.ratio;
      c.beginPath();
      c.moveTo(this.x(mine.at[0]), this.y(mine.at[1]));
      c.lineTo(this.x(other.at[0]), this.y(other.at[1]));
      c.stroke();
    }
    c.setLineDash([]);
    for (const one of belief.claim) {
      const colour = owner(this.state.order.get(one.name) ?? 0);
      this.ring(this.x(one.at[0]), this.y(one.at[1]), Math.max(2, one.radius * this.scale), alpha(colour, 0.9));
    }
  }

  // The agent nearest to a click, by body within reach, else by cell.
  at(event) {
    const { frame } = this.state;
    if (!frame) return null;
    const box = this.canvas.getBoundingClientRect();
    const px = (event.clientX - box.left) * this.ratio, py = (event.clientY - box.top) * this.ratio;
    let best = null, least = 18 * this.unit;
    for (const agent of frame.agents) {
      if (!agent.pose) continue;
      const far = Math.hypot(this.x(agent.pose[0]) - px, this.y(agent.pose[1]) - py);
      if (far < least) { least = far; best = agent.name; }
    }
    if (best) return best;
    for (const agent of frame.agents) {
      if (!agent.cell || !agent.cell.length) continue;
      this.path(agent.cell);
      if (this.pen.isPointInPath(px, py)) return agent.name;
    }
    return null;
  }
}
