// The agent's actions at all places, drawn over the world: arrows, bars, heat, splays, routes.

import { heat, signed, words } from "./colours.js";

const LEAST = 0.04; // of an arrow that is drawn at all

// The mean way of a policy, [x, y] with lengths from 0 to 1.
export function meanWay(policy, ways) {
  let [x, y] = [0, 0];
  policy.forEach((rate, action) => {
    x += rate * ways[action][0];
    y += rate * ways[action][1];
  });
  return [x, y];
}

// The fractions of each of the ways that a policy's actions lead: {"1,0": 0.7, ...}.
export function rateOfWays(policy, ways) {
  const rates = {};
  policy.forEach((rate, action) => {
    const way = String(ways[action]);
    rates[way] = (rates[way] ?? 0) + rate;
  });
  return rates;
}

// fields: a Map of "x,y" -> {cell, policy, value}; colour and edge: of the arrows.
export function drawArrows(brush, fields, ways, colour, edge) {
  for (const { cell: [x, y], policy } of fields.values()) {
    const [dx, dy] = meanWay(policy, ways);
    const length = Math.hypot(dx, dy);
    if (length < LEAST) dot(brush, x + 0.5, y + 0.5, colour, edge);
    else arrow(brush, x + 0.5, y + 0.5, dx, dy, Math.min(length, 1), colour, edge);
  }
}

function dot(brush, x, y, colour, edge) {
  brush.circle(x, y, Math.max(1.5 / brush.scale, 0.06));
  brush.stroke(edge, 0.05);
  brush.shade(colour);
}

// An arrow about the centre (x, y), as long as the policy is sure.
function arrow({ paint, scale, top }, x, y, dx, dy, sure, colour, edge) {
  const angle = Math.atan2(-dy, dx);
  const [length, wide] = [0.22 + 0.6 * sure, 0.045 + 0.055 * sure];
  const [tail, tip] = [-length / 2, length / 2];
  const head = Math.min(0.26, 0.55 * length);
  paint.save();
  paint.translate(x * scale, (top - y) * scale);
  paint.rotate(angle);
  paint.scale(scale, scale);
  paint.beginPath();
  paint.moveTo(tail, -wide / 2);
  paint.lineTo(tip - head, -wide / 2);
  paint.lineTo(tip - head, -head / 2.1);
  paint.lineTo(tip, 0);
  paint.lineTo(tip - head, head / 2.1);
  paint.lineTo(tip - head, wide / 2);
  paint.lineTo(tail, wide / 2);
  paint.closePath();
  paint.lineJoin = "round";
  paint.lineWidth = Math.max(0.07, 2 / scale);
  paint.strokeStyle = edge;
  paint.stroke();
  paint.fillStyle = colour;
  paint.fill();
  paint.restore();
}

// In every cell a bar towards each side, as long as the policy goes there.
export function drawBars(brush, fields, ways, colour, edge) {
  brush.paint.lineCap = "butt";
  for (const { cell: [x, y], policy } of fields.values()) {
    const centre = [x + 0.5, y + 0.5];
    const rates = rateOfWays(policy, ways);
    for (const [way, rate] of Object.entries(rates)) {
      const [dx, dy] = way.split(",").map(Number);
      if ((!dx && !dy) || rate < 0.02) continue;
      const reach = (0.46 * rate) / Math.hypot(dx, dy);
      brush.path([centre, [centre[0] + dx * reach, centre[1] + dy * reach]]);
      brush.stroke(edge, 0.15, 1.2);
      brush.stroke(colour, 0.09, 1.2);
    }
    brush.circle(...centre, Math.max(1 / brush.scale, 0.03 + 0.13 * (rates["0,0"] ?? 0)));
    brush.shade(colour);
  }
}

// Numbers of cells as colours, from the least to the largest: {low, high}, for a legend.
export function drawHeat(brush, fields, number, alpha = 0.85) {
  const numbers = [...fields.values()].map(number);
  const [low, high] = [Math.min(...numbers), Math.max(...numbers)];
  for (const one of fields.values()) {
    const rate = high > low ? (number(one) - low) / (high - low) : 0.5;
    brush.fill(heat(rate, alpha), ...one.cell);
  }
  return { low, high };
}

// Differences from 0 in two hues, the largest the darkest.
export function drawDifference(brush, fields, number, alpha = 0.85) {
  const most = Math.max(1e-9, ...[...fields.values()].map((one) => Math.abs(number(one))));
  for (const one of fields.values()) brush.fill(signed(number(one) / most, alpha), ...one.cell);
  return { low: -most, high: most };
}

// For every place of a thing, a mark in the outcomes' colours: a disc for the intended goal, a
// diamond for a proxy, a cross for neither; a disc in parts where episodes differ.
export function drawSplay({ paint, scale, top }, splay, colours, edge, intended) {
  paint.lineWidth = Math.max(1, 0.05 * scale);
  for (const { cell: [x, y], outcomes } of splay.values()) {
    const total = Object.values(outcomes).reduce((a, b) => a + b, 0);
    let angle = -Math.PI / 2;
    const [cx, cy, radius] = [(x + 0.5) * scale, (top - y - 0.5) * scale, 0.36 * scale];
    for (const [goal, count] of Object.entries(outcomes)) {
      const after = angle + (2 * Math.PI * count) / total;
      paint.beginPath();
      if (count < total || goal === intended) {
        if (count < total) paint.moveTo(cx, cy);
        paint.arc(cx, cy, radius, angle, after);
      } else {
        const cross = goal === words.NEITHER;
        const [long, thin] = cross ? [radius, 0.35 * radius] : [1.15 * radius, 0.81 * radius];
        for (let k = 0; k < 8; k++) {
          const [far, turn] = [k % 2 ? thin : long, ((k + Number(cross)) * Math.PI) / 4];
          paint.lineTo(cx + far * Math.cos(turn), cy + far * Math.sin(turn));
        }
      }
      paint.closePath();
      paint.fillStyle = colours[goal] ?? "#888";
      paint.fill();
      paint.strokeStyle = edge;
      paint.stroke();
      angle = after;
    }
  }
}

// A way through the world, and rings around what it takes first.
export function drawRoute(brush, { cells, takes }, colour, edge) {
  brush.paint.lineJoin = brush.paint.lineCap = "round";
  brush.path(cells);
  brush.stroke(edge, 0.2);
  brush.stroke(colour, 0.11);
  for (const [x, y] of takes ?? []) ring(brush, x, y, colour, edge);
}

export function ring(brush, x, y, colour, edge) {
  brush.circle(x + 0.5, y + 0.5, 0.41);
  brush.stroke(edge, 0.16);
  brush.stroke(colour, 0.09);
}
