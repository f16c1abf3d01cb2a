// The hint: a small box that says what a thing is, on hover, on keyboard focus and on tap.
import { TEXTS } from "./texts.js";
import { element } from "./element.js";

export class Hint {
  constructor(box) {
    this.box = box;
    this.about = null; // the element it describes
    this.pointer = ""; // where it was last
    const of = (event) => event.target.closest && event.target.closest("[data-hint]");
    // A thing that is drawn anew under a resting pointer is no new wish: a hint that was closed stays closed.
    const moved = ({ clientX, clientY }) => this.pointer !== (this.pointer = `${clientX} ${clientY}`);
    addEventListener("pointermove", moved);
    addEventListener("pointerover", (event) => { if (moved(event) && event.pointerType !== "touch") this.over(of(event)); });
    addEventListener("focusin", (event) => { const thing = of(event); if (thing && thing.matches(":focus-visible")) this.over(thing); });
    addEventListener("focusout", () => this.hide());
    addEventListener("click", (event) => { const thing = of(event); if (thing) this.over(thing); else if (this.about) this.hide(); });
    addEventListener("scroll", ({ target }) => { if (target === document || target.contains(this.about)) this.hide(); }, true);
  }

  over(thing) {
    if (thing === this.about) return;
    this.hide();
    const words = thing && TEXTS[thing.dataset.hint];
    if (!words) return;
    this.about = thing;
    thing.setAttribute("aria-describedby", this.box.id);
    const place = thing.getBoundingClientRect();
    this.show(words, place.left, place.bottom + 6, place.top - 6);
  }

  // A title and lines below a place, or above it where there is no room, px.
  show([title, ...lines], left, below, above) {
    const text = [title, ...lines].join("\n");
    if (this.box.dataset.text !== text) {
      this.box.dataset.text = text;
      this.box.replaceChildren(element("b", {}, title), ...lines.map((line) => element("span", {}, line)));
    }
    this.box.hidden = false;
    const { width, height } = this.box.getBoundingClientRect();
    this.box.style.left = `${Math.max(6, Math.min(left, innerWidth - width - 6))}px`;
    this.box.style.top = `${below + height < innerHeight ? below : Math.max(6, above - height)}px`;
  }

  hide() {
    if (this.about) this.about.removeAttribute("aria-describedby");
    this.about = null;
    this.box.hidden = true;
  }

  get visible() { return !this.box.hidden; }
}
