// The player of a replay or of a comparison: play, pause, seek, speed.
import { asked } from "./keep.js";

export class Player {
  constructor(find, state) {
    this.state = state;
    this.button = find("play"); this.scrub = find("scrub"); this.speed = find("speed"); this.box = find("player");
    this.scrubbing = false;
    this.wanted = null;
    this.asked = asked().time; // s; of the address
    this.scrub.addEventListener("input", () => {
      this.scrubbing = true;
      if (this.wanted === null) setTimeout(() => { this.seek(this.wanted); this.wanted = null; }, 80);
      this.wanted = Number(this.scrub.value);
    });
    this.scrub.addEventListener("change", () => { this.scrubbing = false; });
    this.button.addEventListener("click", () => this.toggle());
    this.speed.addEventListener("change", () => state.send({ speed: Number(this.speed.value) }));
  }

  get seeks() { return Boolean(this.state.hello) && this.state.hello.source === "replay"; }
  get plays() { return this.seeks || (Boolean(this.state.hello) && this.state.hello.source === "comparison"); }

  begin(hello) {
    this.box.hidden = !this.plays;
    this.scrub.hidden = !this.seeks;
    this.scrub.max = hello.ticks * hello.dt;
    if (this.seeks && this.asked !== null) { this.state.send({ play: false }); this.seek(this.asked); this.asked = null; }
  }

  show(now, time) {
    this.button.textContent = now.playing ? "pause" : "play";
    this.button.setAttribute("aria-pressed", String(now.playing));
    if (!this.scrubbing) this.scrub.value = time;
    if (document.activeElement !== this.speed) this.speed.value = String(now.speed);
  }

  toggle() { const { frame, send } = this.state; send({ play: !(frame && frame.play && frame.play.playing) }); }

  seek(to) { if (this.seeks) this.state.send({ seek: Math.max(0, to) }); }

  by(seconds) { if (this.seeks && this.state.frame) this.seek(this.state.frame.play.clock + seconds); }

  faster(steps) {
    const speeds = [...this.speed.options].map((one) => Number(one.value)), at = speeds.indexOf(this.state.frame.play.speed) + steps;
    this.state.send({ speed: speeds[Math.max(0, Math.min(speeds.length - 1, at))] });
  }
}
