// The player of a replay or of a comparison: play, pause, seek, speed.
import { element } from "./element.js";
import { asked } from "./keep.js";

// The speed that is so many steps from the present one, which may lie between those of the list; at its ends the present one.
export function nextSpeed(speeds, now, steps) {
  const beyond = speeds.filter((one) => (steps > 0 ? one > now : one < now)), at = steps > 0 ? steps - 1 : beyond.length + steps;
  return beyond[Math.max(0, Math.min(beyond.length - 1, at))] ?? now;
}

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
    if (document.activeElement !== this.speed) this.choose(now.speed);
  }

  toggle() { const { frame, send } = this.state; send({ play: !(frame && frame.play && frame.play.playing) }); }

  seek(to) { if (this.seeks) this.state.send({ seek: Math.max(0, to) }); }

  by(seconds) { if (this.seeks && this.state.frame) this.seek(this.state.frame.play.clock + seconds); }

  faster(steps) { this.state.send({ speed: nextSpeed([...this.speed.options].map((one) => Number(one.value)), this.state.frame.play.speed, steps) }); }

  // Show a speed in the list; one of the command line may have to be added.
  choose(speed) {
    const options = [...this.speed.options];
    if (!options.some((one) => Number(one.value) === speed)) this.speed.add(element("option", { value: speed }, `${speed} ×`), options.find((one) => Number(one.value) > speed) ?? null);
    this.speed.value = String(speed);
  }
}
