// The shapes of marks, for the arena and for the legend: each kind has its own.

// A share, from a half to 1: so much smaller are round marks (x, y, x, y, ... in m) of a radius, px, that every other one leaves its nearest free.
export function room(flat, radius, scale) {
  const nearest = [];
  for (let i = 0; i < flat.length; i += 2) {
    let least = Infinity;
    for (let j = 0; j < flat.length; j += 2) if (j !== i) least = Math.min(least, Math.hypot(flat[i] - flat[j], flat[i + 1] - flat[j + 1]));
    nearest.push(least);
  }
  nearest.sort((one, other) => one - other);
  return nearest.length < 2 ? 1 : Math.max(0.5, Math.min(1, (nearest[nearest.length >> 1] * scale) / (2 * radius)));
}

export function disc(c, x, y, size, colour, rim, width) {
  c.beginPath();
  c.arc(x, y, size, 0, 7);
  c.fillStyle = colour;
  c.fill();
  c.strokeStyle = rim;
  c.lineWidth = width;
  c.stroke();
}

export function cross(c, x, y, size, colour, width) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.beginPath();
  c.moveTo(x - size, y - size); c.lineTo(x + size, y + size);
  c.moveTo(x - size, y + size); c.lineTo(x + size, y - size);
  c.stroke();
}

export function bars(c, x, y, size, colour, width) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.beginPath();
  for (const side of [-0.4, 0.4]) { c.moveTo(x + side * size, y - size); c.lineTo(x + side * size, y + size); }
  c.stroke();
}

export function diamond(c, x, y, size, colour) {
  c.fillStyle = colour;
  c.beginPath();
  c.moveTo(x, y - size); c.lineTo(x + size, y); c.lineTo(x, y + size); c.lineTo(x - size, y);
  c.fill();
}

export function arrow(c, x, y, heading, size, colour, rim, width) {
  c.save();
  c.translate(x, y);
  c.rotate(-heading);
  c.beginPath();
  c.moveTo(1.25 * size, 0); c.lineTo(-0.8 * size, 0.75 * size); c.lineTo(-0.4 * size, 0); c.lineTo(-0.8 * size, -0.75 * size);
  c.closePath();
  c.fillStyle = colour;
  c.strokeStyle = rim;
  c.lineWidth = width;
  c.fill();
  c.stroke();
  c.restore();
}
