// What of the arena is seen: zoom and centre, moved by wheel, drag, pinch, double click and keys. Two arenas side by side share one.

const MOST = 40, DRAG = 4; // times; px before a press is a drag

export class View {
  constructor(changed) {
    this.changed = changed;
    this.reset();
  }

  reset() { this.zoom = 1; this.east = 0.5; this.north = 0.5; this.changed(); }

  get moved() { return this.zoom > 1.001; }

  // Zoom by a factor, keeping a place (shares of the arena) where it is on the screen.
  by(factor, east = this.east, north = this.north) {
    const zoom = Math.max(1, Math.min(MOST, this.zoom * factor)), share = 1 - this.zoom / zoom;
    this.east += (east - this.east) * share;
    this.north += (north - this.north) * share;
    this.zoom = zoom;
    this.pan(0, 0);
  }

  // Move by shares of the arena.
  pan(east, north) {
    const half = 0.5 / this.zoom, keep = (at) => Math.max(half, Math.min(1 - half, at));
    this.east = keep(this.east + east);
    this.north = keep(this.north + north);
    this.changed();
  }
}

// Wheel, drag, pinch and double click on an arena. `held(event)` may take a press for itself: it returns what follows the drag, or null.
export function attach(arena, view, held) {
  const { canvas } = arena, down = new Map();
  let dragged = false, follow = null;
  const share = (event) => { const [x, y] = arena.place(event), [east, north] = arena.state.hello.arena; return [x / east, y / north]; };
  canvas.addEventListener("wheel", (event) => {
    if (!arena.state.hello) return;
    event.preventDefault();
    view.by(Math.exp(-Math.max(-120, Math.min(120, event.deltaY * (event.deltaMode ? 30 : 1))) / 300), ...share(event));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (!arena.state.hello || event.button > 0) return;
    if (!down.size) { dragged = false; follow = held(event); }
    down.set(event.pointerId, { x: event.clientX, y: event.clientY, fromX: event.clientX, fromY: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const finger = down.get(event.pointerId);
    if (!finger) return;
    if (!dragged && Math.hypot(event.clientX - finger.fromX, event.clientY - finger.fromY) < DRAG) return;
    if (!dragged) canvas.setPointerCapture(event.pointerId);
    dragged = true;
    const [width, height] = arena.span(), before = spread(down);
    const right = event.clientX - finger.x, up = finger.y - event.clientY, fingers = down.size;
    finger.x = event.clientX; finger.y = event.clientY;
    if (follow && fingers === 1) follow(arena.place(event), false);
    else {
      if (fingers === 2 && before > 0) view.by(spread(down) / before, ...share(middle(down)));
      view.pan(-right / fingers / width, -up / fingers / height);
    }
  });
  const lift = (event) => {
    if (!down.delete(event.pointerId)) return;
    if (follow && dragged) follow(arena.place(event), true);
    if (!down.size) follow = null;
  };
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, lift);
  canvas.addEventListener("click", (event) => { if (dragged) { event.stopImmediatePropagation(); dragged = false; } });
  canvas.addEventListener("dblclick", () => view.reset());
}

// Distance and middle of two fingers, px.
function spread(down) {
  const [one, two] = [...down.values()];
  return two ? Math.hypot(one.x - two.x, one.y - two.y) : 0;
}

function middle(down) {
  const [one, two] = [...down.values()];
  return { clientX: (one.x + two.x) / 2, clientY: (one.y + two.y) / 2 };
}
