// Shared by the rules of all grid worlds: `astray.grid`, for a page without Python.
//
// `astray.lab.translate` writes each world's own part, rules/NAME.js, from its Python.

import { mixTwo } from "../agent/noise.js";
import { NEVER, WALL, checkAgent, distances, unreachable } from "./common.js";
import { grid as counted } from "./constants.js";
import { Twister } from "./twister.js";

const { OVER } = counted;

export const floorDiv = (a, b) => Math.floor(a / b);
export const mod = (a, b) => a - b * Math.floor(a / b);
export const bitOr = (a, b) => Number(BigInt(a) | BigInt(b));
export const bitAnd = (a, b) => Number(BigInt(a) & BigInt(b));
export const shiftLeft = (a, b) => exact(Number(BigInt(a) << BigInt(b)));
export const shiftRight = (a, b) => Number(BigInt(a) >> BigInt(b));
export const from = (at, rows) => (at < 0 ? at + rows.length : at); // as in Python
export const yes = (x) => (Array.isArray(x) ? x.length > 0 : Boolean(x));
export const or = (one, other) => (yes(one) ? one : other());
export const below = (s, n) => s.draws.below(n);

export function exact(number) {
  if (!Number.isInteger(number) || Number.isSafeInteger(number)) return number;
  throw new Error("the rules multiply to an integer above 2 ** 53, which needs Python: astray lab");
}

export function fill(rows, value) {
  rows.forEach((row, y) => { if (typeof row === "object") fill(row, value); else rows[y] = value; });
}

export function copyFlat(target, source) {
  target.forEach((row, y) => {
    if (typeof row === "object") copyFlat(row, source[y]); else target[y] = source[y];
  });
}

export function where(layer, ...codes) {
  const found = [];
  layer.forEach((row, y) => row.forEach((what, x) => codes.includes(what) && found.push([x, y])));
  return found;
}

export function settle(s) {
  let number = 0n;
  s.cell.forEach((row, y) => row.forEach((what, x) => {
    number = mixTwo(number, BigInt(what + 256 * s.mover[y][x]));
  }));
  s.draws = new Twister(Number(number & 0xffffffffn));
}

export function gridRules(world) {
  const { side, seen, kinds, held, solid } = world;

  function build({ grid, agent, looks = {} }, variant) {
    const [x, y] = agent.map(Math.floor);
    checkAgent(grid, [x, y], world);
    if (grid.length !== side || grid[0].length !== side) {
      throw new Error(`the level is (${grid.length}, ${grid[0].length}); it must be ${side} cells a side`);
    }
    const s = Object.fromEntries(world.numbers.map((name) => [name, 0]));
    Object.assign(s, {
      cell: grid.map((row) => Uint8Array.from(row, (what) => what % OVER)),
      mover: grid.map((row) => Uint8Array.from(row, (what) => Math.floor(what / OVER))),
      x, y, held: 0, time: 0, time_limit: variant.time_limit, ended: false, level: 0,
    });
    for (const event of world.events) s[event] = NEVER;
    settle(s);
    const number = ([name, value]) => [name, world.choices[name]?.indexOf(value) ?? Number(value)];
    world.furnish(s, Object.fromEntries(Object.entries(variant).map(number)));
    for (const [name, usual] of Object.entries(world.looks)) s[name] = looks[name] ?? usual;
    return s;
  }

  function copy(s) {
    const [cell, mover] = [s.cell, s.mover].map((rows) => rows.map((row) => row.slice()));
    return { ...s, cell, mover, draws: s.draws.copy() };
  }

  // The agent's observation, planes [C, H, W]: each kind, what is held, the agent.
  function planes(s) {
    const [count, edge] = [kinds + held, seen > side ? [side - 1 - s.x, side - 1 - s.y] : [0, 0]];
    const data = new Uint8Array(count * seen * seen);
    const mark = (plane, x, y) => { data[(plane * seen + y) * seen + x] = 1; };
    const [left, low] = edge;
    const inside = (at, first) => first <= at && at < first + side;
    for (let y = 0; y < seen; y++) {
      for (let x = 0; x < seen; x++) {
        if (!inside(x, left) || !inside(y, low)) mark(WALL - 1, x, y);
        else if (s.held > 0) mark(count - 1 - s.held, x, y);
      }
    }
    for (let y = 0; y < side; y++) {
      for (let x = 0; x < side; x++) {
        for (const code of [s.cell[y][x], s.mover[y][x]]) if (code) mark(code - 1, left + x, low + y);
      }
    }
    mark(count - 1, left + s.x, low + s.y);
    return { shape: [count, seen, seen], data };
  }

  function ways(s) {
    return distances(s.cell.map((row) => [...row].map((what) => !solid.includes(what))), s.x, s.y);
  }

  function problem({ grid }, s) {
    const steps = ways(s);
    return unreachable(grid, [s.x, s.y], Object.entries(world.objects), (x, y) => steps[y][x] >= 0);
  }

  function places(s) {
    const [steps, found] = [ways(s), []];
    steps.forEach((row, y) => row.forEach((away, x) => {
      const free = away >= 0 && !s.cell[y][x] && !s.mover[y][x];
      if (free || (x === s.x && y === s.y)) found.push([x, y]);
    }));
    return found;
  }

  const put = (s, [x, y]) => ({ ...copy(s), x, y });
  const centre = (s) => [s.x + 0.5, s.y + 0.5];
  const view = (s) => ({
    agent: centre(s), picture: world.agents[s.held],
    grid: s.cell.map((row, y) => [...row].map((what, x) => what + OVER * s.mover[y][x])),
  });

  // The cell of a goal; null where it has none, or moves.
  function target(s, goal) {
    const found = world.seek(s, goal);
    const [cell] = Array.isArray(found) && found.length === 1 ? found : [];
    return cell && !s.mover[cell[1]][cell[0]] ? cell : null;
  }

  return { build, step: world.step, planes, copy, problem, places, put, centre, view, target };
}
