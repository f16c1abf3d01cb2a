// Colours of the cells: two cells that touch never share one, and an agent keeps its colour from frame to frame while it can.

const NEAR = 0.03; // m; corners come rounded to the centimetre

// The square of the distance of a point to a segment.
function apart(x, y, ax, ay, bx, by) {
  const dx = bx - ax, dy = by - ay, long = dx * dx + dy * dy;
  const share = long > 0 ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / long)) : 0;
  return (x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2;
}

// Whether a corner of one polygon (x, y, x, y, ...) lies on the border of another.
function cornerOn(one, other) {
  for (let i = 0; i < one.length; i += 2) {
    for (let j = 0, k = other.length - 2; j < other.length; k = j, j += 2) {
      if (apart(one[i], one[i + 1], other[k], other[k + 1], other[j], other[j + 1]) <= NEAR * NEAR) return true;
    }
  }
  return false;
}

function box(cell) {
  const found = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = 0; i < cell.length; i += 2) {
    found[0] = Math.min(found[0], cell[i]); found[1] = Math.min(found[1], cell[i + 1]);
    found[2] = Math.max(found[2], cell[i]); found[3] = Math.max(found[3], cell[i + 1]);
  }
  return found;
}

// For each cell the indices of those that touch it. Convex cells that tile: where two touch, a corner of one lies on the other.
export function touching(cells) {
  const boxes = cells.map(box), sides = cells.map(() => []);
  for (let i = 0; i < cells.length; i++) {
    for (let j = 0; j < i; j++) {
      const a = boxes[i], b = boxes[j];
      if (a[0] > b[2] + NEAR || b[0] > a[2] + NEAR || a[1] > b[3] + NEAR || b[1] > a[3] + NEAR) continue;
      if (cornerOn(cells[i], cells[j]) || cornerOn(cells[j], cells[i])) { sides[i].push(j); sides[j].push(i); }
    }
  }
  return sides;
}

// Smallest last: each cell has at most five neighbours before it where cells tile a plane.
function inOrder(sides) {
  const left = new Set(sides.keys()), degree = sides.map((side) => side.length), order = [];
  while (left.size) {
    let least = -1;
    for (const at of left) if (least < 0 || degree[at] < degree[least]) least = at;
    left.delete(least);
    for (const other of sides[least]) degree[other] -= 1;
    order.push(least);
  }
  return order.reverse();
}

// The number of a colour for each cell, 0 to `most` - 1; `before` are those of the frame before.
export function colouring(cells, before, most) {
  const sides = touching(cells), chosen = before.slice();
  if (sides.every((side, at) => side.every((other) => before[at] !== before[other]))) return chosen;
  const done = new Set();
  for (const at of inOrder(sides)) {
    const taken = new Set(sides[at].filter((other) => done.has(other)).map((other) => chosen[other]));
    if (taken.has(before[at])) {
      const wanted = new Set(sides[at].map((other) => before[other])), free = [...Array(most).keys()].filter((colour) => !taken.has(colour));
      chosen[at] = free.find((colour) => !wanted.has(colour)) ?? free[0] ?? before[at];
    }
    done.add(at);
  }
  return chosen;
}
