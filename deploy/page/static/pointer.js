// The pointer over an arena: what lies under it is named and explained, and an agent's neighbours stand out; a click chooses.
// Returns what looks again, after the arena has been drawn: things move under a pointer that rests.
import { agentLines, TEXTS } from "./texts.js";

export function pointAt(arena, state, hint, schedule, choose) {
  const { canvas } = arena;
  let latest = null, resting = null;
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons || event.pointerType === "touch") return;
    if (!latest) requestAnimationFrame(() => { const now = latest; latest = null; if (now) look((resting = now)); });
    latest = event;
  });
  canvas.addEventListener("pointerleave", () => { latest = resting = null; point(null); hint.hide(); });
  canvas.addEventListener("pointerdown", () => { resting = null; hint.hide(); });
  canvas.addEventListener("click", (event) => {
    const found = arena.under(event);
    if (event.pointerType === "touch") look(event);
    if (found && (found.kind === "agent" || found.kind === "cell")) choose(found.name);
    else if (!found && state.chosen) choose(state.chosen);
  });
  return () => { if (resting && hint.visible && !hint.about) look(resting); };

  function point(name) {
    if (state.pointed === name) return;
    state.pointed = name;
    schedule();
  }

  function look(event) {
    const found = arena.under(event);
    point(found && found.kind !== "target" ? found.name : null);
    if (!found) { hint.hide(); return; }
    hint.show(words(found, arena.scene, state), event.clientX + 14, event.clientY + 14, event.clientY - 10);
  }
}

// The title and the lines for what is under the pointer.
function words({ kind, name, index }, scene, state) {
  if (kind === "target") return [`Target ${scene.frame.ids[index]}`, ...TEXTS.truth.slice(1)];
  if (kind === "estimate") {
    const { labels } = scene.agent(name);
    return [`Estimate of ${name}${labels ? `, track ${labels[index]}` : ""}`, ...TEXTS.estimates.slice(1)];
  }
  const outfit = state.hello.agents[state.order.get(name)];
  return [kind === "cell" ? `Cell of ${name}` : name, ...agentLines(scene.agent(name), outfit)];
}
