// The keys of the page.

const PAN = 0.12, ZOOM = 1.4, LONG = 10; // shares of what is seen; times; s that Shift jumps

export function keys(page) {
  // A button that was clicked does not keep the focus: Space is the player's then. One that was reached by Tab has it. The slider and the speed likewise.
  // At first, before the click is answered: a hint that goes with the focus comes back with the click.
  addEventListener("click", (event) => { const button = event.detail && event.target.closest("button"); if (button) button.blur(); }, true);
  addEventListener("change", ({ target }) => { if (!target.matches(":focus-visible")) target.blur(); });
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || ["INPUT", "SELECT"].includes(event.target.tagName)) return;
    if (event.key === "Escape" || pressed(page, event)) { if (event.key === "Escape") page.escape(); event.preventDefault(); }
  });
}

// Whether a key was one of the page's.
function pressed({ state, view, player, switches, flip, theme, help, hold, step, readAt, charts }, event) {
  const found = switches.find(([key]) => key === event.key), back = event.key === "ArrowLeft" ? -1 : 1, down = event.key === "ArrowUp" ? -1 : 1;
  const aside = event.key === "ArrowLeft" || event.key === "ArrowRight", along = event.key === "ArrowUp" || event.key === "ArrowDown";
  if (found) flip(found[1]);
  else if (event.key === "x") theme();
  else if (event.key === "?") help();
  else if (event.key === "+" || event.key === "=") view.by(ZOOM);
  else if (event.key === "-") view.by(1 / ZOOM);
  else if (event.key === "0") view.reset();
  else if (charts.includes(event.target) && aside) readAt(Math.max(0, (state.readout ?? state.frame.time) + back * Math.max(1, state.hello.dt)));
  else if (event.shiftKey && view.moved && (aside || along)) view.pan(aside ? (back * PAN) / view.zoom : 0, along ? (-down * PAN) / view.zoom : 0);
  else if (aside && player.seeks) player.by(back * (event.shiftKey ? LONG : 1));
  else if (aside) step(back);
  else if (along && !scrolls(event.target)) step(down);
  else if (event.key === " " && event.target.tagName !== "BUTTON") player.plays ? player.toggle() : hold();
  else if (player.plays && (event.key === "<" || event.key === ">")) player.faster(event.key === "<" ? -1 : 1);
  else return false;
  return true;
}

// Whether up and down scroll what has the focus.
function scrolls(thing) { return ["log", "help"].includes(thing.id); }
