// The goals that a walk is evidence for, if the walker is an agent: `astray.agency.online`, with the
// settings called CALIBRATED there. Whether it is an agent at all needs Python.

import { goals } from "../rules/constants.js";
import { distances } from "../rules/kernels.js";

const { BETA } = goals;
const SIDES = [[0, 1], [0, -1], [-1, 0], [1, 0]];

// The posterior over `open` cells [y][x] after every step: {cells [G], rates [T + 1][G]}.
export function posterior(open, way) {
  check(open, way);
  const moves = way.filter((cell, k) => k === 0 || String(cell) !== String(way[k - 1]));
  const start = distances(open, ...way[0]);
  const cells = [];
  for (let y = open.length - 1; y >= 0; y--) { // the uppermost row first, as there
    for (let x = 0; x < open[y].length; x++) if (start[y][x] >= 0) cells.push([x, y]);
  }
  const steps = cells.map(([x, y]) => distances(open, x, y));
  const nodes = ruleOf(moves.length - 1);
  const weights = cells.map(() => nodes.map(() => 0));
  const rates = [rateOf(weights, nodes)];
  for (let t = 1; t < moves.length; t++) {
    steps.forEach((away, g) => {
      const kind = kindOf(open, away, moves[t - 1], moves[t]);
      nodes.forEach(({ eps }, n) => { weights[g][n] += logStep(kind, eps); });
    });
    rates.push(rateOf(weights, nodes));
  }
  let moved = -1;
  const counted = way.map((cell, k) => {
    if (k === 0 || String(cell) !== String(way[k - 1])) moved += 1;
    return rates[moved];
  });
  return { cells, rates: counted };
}

// Throws where a walk is not from cell to cell, in the words of `World.path`.
function check(open, way) {
  const told = (cell) => `(${cell.join(", ")})`;
  const wall = way.find(([x, y]) => !open[y][x]);
  if (wall) throw new Error(`cell ${told(wall)} is a wall; an agent or a goal needs a free cell`);
  way.slice(1).forEach((cell, k) => {
    const far = Math.abs(cell[0] - way[k][0]) + Math.abs(cell[1] - way[k][1]);
    if (far > 1) throw new Error(`a path moves one cell at a time; no move leads from ${told(way[k])} to ${told(cell)}`);
  });
}

// Whether a step comes nearer to a goal, how many others would, and how many steps there are.
function kindOf(open, away, [x, y], [u, v]) {
  const around = SIDES.map(([dx, dy]) => [x + dx, y + dy]).filter(([i, j]) => open[j]?.[i]);
  const here = away[y][x];
  if (here === 0) return { best: true, k: around.length, of: around.length };
  const nearer = around.filter(([i, j]) => away[j][i] === here - 1);
  return { best: away[v][u] === here - 1, k: nearer.length, of: around.length };
}

function logStep({ best, k, of }, eps) {
  if (k === of) return -Math.log(of);
  return Math.log((best ? (1 - eps) / k : 0) + eps / of);
}

function rateOf(weights, nodes) {
  const logs = weights.map((row) => logSum(row.map((w, n) => w + nodes[n].logWeight)));
  const all = logSum(logs);
  return logs.map((log) => Math.exp(log - all));
}

function logSum(logs) {
  const most = Math.max(...logs);
  return most + Math.log(logs.reduce((sum, log) => sum + Math.exp(log - most), 0));
}

// Gauss-Legendre nodes in (0, 1) under the prior Beta(1, BETA) of how often an agent errs.
function ruleOf(degree) {
  const half = Math.floor((degree + Math.ceil(BETA - 1)) / 2);
  const n = Math.max(16, 2 ** (half === 0 ? 0 : Math.floor(Math.log2(half)) + 1));
  return Array.from({ length: n }, (_, i) => {
    let x = Math.cos((Math.PI * (i + 0.75)) / (n + 0.5));
    let slope = 1;
    for (let turn = 0; turn < 100; turn++) {
      let [one, two] = [1, 0];
      for (let k = 0; k < n; k++) [one, two] = [((2 * k + 1) * x * one - k * two) / (k + 1), one];
      slope = (n * (x * one - two)) / (x * x - 1);
      const change = one / slope;
      x -= change;
      if (Math.abs(change) < 1e-16) break;
    }
    const weight = 2 / ((1 - x * x) * slope * slope);
    const eps = (1 + x) / 2;
    return { eps, logWeight: Math.log((weight / 2) * BETA) + (BETA - 1) * Math.log(1 - eps) };
  });
}
