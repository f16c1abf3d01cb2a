// The guided tour: five cards beside what they explain. It stands in nobody's way, can be skipped, and is remembered.
import { element } from "./element.js";
import { TOUR } from "./texts.js";

const KEPT = "covey-tour";

export class Tour {
  constructor(card) {
    this.card = card;
    this.at = -1;
    this.where = element("small");
    this.title = element("h2");
    this.text = element("p");
    const [back, next, skip] = [["back", -1], ["next", 1], ["skip", 0]].map(([name, by]) => {
      const button = element("button", { type: "button", id: `tour-${name}` }, name);
      button.addEventListener("click", () => (by ? this.go(this.at + by) : this.end()));
      return button;
    });
    this.back = back; this.next = next;
    card.append(this.where, this.title, this.text, element("div", {}, skip, back, next));
    addEventListener("resize", () => this.place());
  }

  get running() { return this.at >= 0; }

  // Begin unless it has been seen before.
  offer() {
    try { if (localStorage.getItem(KEPT)) return; } catch { return; }
    this.go(0);
  }

  go(step) {
    this.unmark();
    if (step >= TOUR.length) { this.end(); return; }
    this.at = Math.max(0, step);
    const { at, title, text } = TOUR[this.at];
    this.where.textContent = `${this.at + 1} of ${TOUR.length}`;
    this.title.textContent = title;
    this.text.textContent = text;
    this.back.disabled = this.at === 0;
    this.next.textContent = this.at === TOUR.length - 1 ? "done" : "next";
    this.card.hidden = false;
    const thing = document.querySelector(at);
    thing.classList.add("toured");
    thing.scrollIntoView({ block: "nearest" });
    this.place();
    this.next.focus({ preventScroll: true });
  }

  // Beside the thing where there is room: left of it, else above it, else below it, else at its lower edge.
  place() {
    if (!this.running) return;
    const thing = document.querySelector(TOUR[this.at].at).getBoundingClientRect(), { width, height } = this.card.getBoundingClientRect();
    const aside = thing.left > width + 24, below = innerHeight - thing.bottom > height + 24;
    const left = aside ? thing.left - width - 12 : thing.left + 12;
    const top = aside ? thing.top : thing.top > height + 24 ? thing.top - height - 12 : below ? thing.bottom + 12 : thing.bottom - height - 12;
    this.card.style.left = `${Math.max(8, Math.min(left, innerWidth - width - 8))}px`;
    this.card.style.top = `${Math.max(8, Math.min(top, innerHeight - height - 8))}px`;
  }

  end() {
    this.unmark();
    this.at = -1;
    this.card.hidden = true;
    this.next.blur(); // at once, and not when the page is drawn next: the next key is the page's
    try { localStorage.setItem(KEPT, "seen"); } catch { /* not kept */ }
  }

  unmark() { for (const thing of document.querySelectorAll(".toured")) thing.classList.remove("toured"); }
}
