// Every explanation of the page: a name, and short sentences with one fact each.

export const TEXTS = {
  // figures and curves
  OSPA: ["OSPA", "How far the estimates are from the true targets, in metres.", "A missed or an invented target counts as the cut-off.", "0 would be perfect."],
  GOSPA: ["GOSPA", "The sum of all errors, in metres.", "Found targets add their distance.", "Each missed or invented target adds half the cut-off.", "Unlike OSPA it grows with the number of targets."],
  targets: ["Targets", "Left: how many targets the agents report.", "Right: how many there are.", "Only you see the true number. The agents never do."],
  "in cells": ["Mass in the cells", "The expected number of targets, summed over all agents.", "Each agent counts in its own cell, so no target counts twice."],
  alive: ["Alive", "Agents whose process runs, of all.", "Choose one and kill it: the others take its cell."],
  hole: ["Hole", "The share of the arena that lies in no agent's cell.", "It is 0 unless somebody has just died.", "It closes within a tick or two."],
  overlap: ["Overlap", "The sum of all cells minus the ground that they cover together, as a share of the arena.", "It is 0 while all agents know the same neighbours.", "After a cut each side takes the whole arena."],
  messages: ["Messages", "Messages of all agents and of the world, per second of your clock.", "No one is in charge: each agent tells all what it sees."],
  ticks: ["Ticks", "Rounds that the swarm plays per second, and how many were asked for."],
  skipped: ["Skipped", "Rounds that agents left out because they had too little time."],
  // columns of the list
  agent: ["Agent", "The name, and the class of its sensor.", "Choose it to see what it believes."],
  state: ["State", "Alive, listening (it has just come), silent, paused or dead.", "·2 means that it has been restarted once."],
  U: ["Unused capacity U", "How much of its sensor's power an agent has left, in m².", "An agent that watches many targets has little left.", "In a power diagram U makes its cell larger or smaller."],
  "g(U)": ["Power radius", "The radius that stands for U in the diagram, in metres. It is that of U one round before.", "A larger radius pushes the border of the cell outwards."],
  load: ["Load", "Expected targets within the footprint of the sensor."],
  mass: ["Mass", "Expected targets within the cell.", "The agent answers for these."],
  round: ["Round", "How long the agent's last round took, in ms."],
  age: ["Age", "How old the agent's last message is, in seconds of the world."],
  "rej.": ["Rejected", "Messages that were refused because they made no sense."],
  "skip.": ["Skipped", "Rounds that this agent left out."],
  // marks and layers
  cells: ["Cells", "The arena is divided among the agents: a power diagram, or one without weights (Voronoi).", "Each agent answers for its cell.", "Two cells that touch never share a colour."],
  density: ["Density", "Where the agents expect targets: the PHD.", "The brighter, the more targets are expected there."],
  footprints: ["Footprints", "What each sensor can see.", "Targets outside all footprints cannot be detected."],
  centroids: ["COD, centroid of detection", "The middle of what a sensor sees well.", "The diagram is drawn around it, not around the body.", "The line leads from the body to it."],
  detections: ["Detections", "Points that the sensors measured in this tick.", "Some are false: clutter."],
  truth: ["True targets", "Where the targets are in the world.", "The agents do not know it. The page shows it to you."],
  estimates: ["Estimates", "Where the agents say that targets are.", "A dot in a ring is a target that was found.", "An empty ring was missed. A dot alone is false."],
  trails: ["Trails", "The ways of the last 12 s, or of 24 ticks where these are longer.", "Agents have their colours, targets are thin, tracks have labels.", "A label that jumps leaves a gap."],
  hold: ["Hold", "The picture stands still until you press it again. The swarm goes on."],
  names: ["Names", "The names of the agents."],
  belief: ["Belief of the chosen agent", "Drawn from its own messages alone.", "Dots: its particles. Dashed outline: its cell.", "Wide rings in the colour of estimates: its estimates."],
  gossip: ["Gossip", "Dashes run along a link when an agent has said something.", "They stand still while it is silent."],
  staleness: ["Staleness", "A cell turns red as the last message of its agent grows old.", "Fully red: its neighbours hold it for silent."],
  dead: ["Dead", "The process has ended.", "Its last cell fades into those of its heirs."],
  claim: ["Claim", "The agents, their places and radii from which an agent cut its cell.", "A circle for each, as large as its power radius.", "It sends the claim along, so others can check it."],
  // the agent's panel
  neighbours: ["Neighbours", "The agents whose cells bound this one.", "Only they matter for its cell."],
  counters: ["Counters", "What the agent has counted since its start."],
  // tools
  link: ["Link to this second", "Copies an address with the time and the chosen agent.", "A replay that is served there opens at that second."],
  png: ["Picture", "Saves what the arena shows as a PNG file."],
  film: ["GIF", "Films the arena, ten frames a second, until you press it again. Then it is saved as a GIF."],
  tour: ["Tour", "Five steps that explain the page."],
  strip: ["Time line", "The whole run: marks show deaths, returns, cuts and commands."],
};

export const TOUR = [
  { at: "#frame", title: "A swarm without a master", text: "You look at an arena from above. Each arrow is a sensor that moves by itself. Each coloured cell belongs to one sensor, and it answers for that cell. Nobody is in charge." },
  { at: "#legend", title: "What they look for", text: "Rings are the true targets. Sensors do not know them. They only get detections, and some are false. Dots are what the swarm believes. A dot in a ring is a target that was found." },
  { at: "#figures", title: "How well it goes", text: "OSPA is the error in metres: the lower, the better. Hole is ground that nobody answers for. Point at any figure, and it says what it means." },
  { at: "#team", title: "What one of them believes", text: "Choose an agent here or in the arena. You see its particles, its cell and its neighbours, as it knows them from messages alone." },
  { at: "#events", title: "Kill one", text: "In a live swarm, choose an agent and press Kill. Its neighbours take its cell within a tick or two. What came of it is written here as a sentence." },
];

// Say the cut-off of a run, m, in figures.
export function tellCutoff(cutoff) {
  TEXTS.OSPA[2] = `A missed or an invented target counts as ${cutoff} m.`;
  TEXTS.GOSPA[3] = `Each missed or invented target adds ${cutoff / 2} m.`;
}

// A number with so many digits after the point, fewer where it is large; a dash for null.
export function short(value, digits) {
  if (value === null) return "–";
  const size = Math.abs(value);
  return size >= 1e5 ? value.toExponential(2).replace("e+", "e") : value.toFixed(size >= 1000 ? 0 : size >= 100 ? Math.min(1, digits) : digits);
}

// What an agent's numbers say, in sentences.
export function agentLines(agent, outfit) {
  if (agent.state === "dead") return ["Its process has ended.", "Its neighbours answer for its former cell."];
  if (agent.mass === undefined) return ["It has not spoken yet."];
  const lines = [`It expects ${short(agent.mass, 2)} targets in its cell.`, `It reports ${agent.targets.length / 2}.`, `Unused capacity U: ${short(agent.unused, 1)} m².`];
  if (agent.neighbours && agent.neighbours.length) lines.push(`Its neighbours: ${agent.neighbours.join(", ")}.`);
  if (agent.age > 0) lines.push(`Its last message is ${agent.age.toFixed(2)} s old.`);
  return outfit && outfit.class ? [`Sensor of class ${outfit.class}, ${agent.state}.`, ...lines] : lines;
}
