// Shared by the rules of all games: actions, cells, ways, and sentences about levels.
// All constants are Python's: `astray.lab.constants` writes the module that has them. So are the
// step of each game and what an agent sees: `astray.lab.translate` writes rules/NAME-kernels.js.

import { common } from "./constants.js";

export const { NEVER, WALL } = common;
const { MOVES } = common;

const EMPTY = "."; // in every game's drawings

// The push of an action, [x, y] from -1 to 1.
export function push(action) {
  return action < MOVES ? [Math.floor(action / 3) - 1, (action % 3) - 1] : [0, 0];
}

// Steps from every cell of `open` [y][x] to (x, y); -1 where there is no way.
export function distances(open, x, y) {
  const steps = open.map((row) => row.map(() => -1));
  steps[y][x] = 0;
  const queue = [[x, y]];
  for (let k = 0; k < queue.length; k++) {
    const [i, j] = queue[k];
    for (const [u, v] of [[i + 1, j], [i - 1, j], [i, j + 1], [i, j - 1]]) {
      if (open[v]?.[u] && steps[v][u] < 0) {
        steps[v][u] = steps[j][i] + 1;
        queue.push([u, v]);
      }
    }
  }
  return steps;
}

// Throws where no episode can begin in a level, in the words of Python's `Level`.
export function checkAgent(grid, [x, y], { LEGEND, STOOD_ON }) {
  if (!(x >= 0 && y >= 0 && y < grid.length && x < grid[0].length)) {
    throw new Error(`the agent is at cell (${x}, ${y}), outside of the level`);
  }
  const char = Object.keys(LEGEND).find((one) => LEGEND[one] === grid[y][x]);
  if (char !== EMPTY && !STOOD_ON.includes(char)) {
    throw new Error(`cell (${x}, ${y}) holds '${char}'`);
  }
}

// The first object that the agent cannot get to, in a sentence; null where there is none.
export function unreachable(grid, [x, y], objects, reached) {
  for (const [name, code] of objects) {
    for (let v = 0; v < grid.length; v++) {
      for (let u = 0; u < grid[v].length; u++) {
        if (grid[v][u] === code && !reached(u, v)) {
          return `the ${name} at cell (${u}, ${v}) cannot be reached from (${x}, ${y})`;
        }
      }
    }
  }
  return null;
}

export function cellsOf(grid, code) {
  const found = [];
  grid.forEach((row, y) => row.forEach((what, x) => what === code && found.push([x, y])));
  return found;
}

const blank = (planes, side) => Array.from({ length: planes }, () =>
  Array.from({ length: side }, () => new Uint8Array(side)));

// The part of observations that does not move, and is wider than they are, as kernels draw it.
export function drawn(kernels, s, count, side) {
  const scene = blank(count, side);
  kernels.background_planes(s, scene);
  return scene;
}

// The observation of a state, planes [C, H, W].
export function observed(kernels, s, scene, count, side) {
  const planes = blank(count, side);
  kernels.foreground_planes(s, scene, planes);
  const data = new Uint8Array(count * side * side);
  planes.flat().forEach((row, k) => data.set(row, k * side));
  return { shape: [count, side, side], data };
}

// The same in a maze, of which the agent sees all or a window around it.
export function observedMaze(kernels, s, count) {
  const side = s.window ? 2 * Math.floor(s.window / 2) + 1 : s.world;
  return observed(kernels, s, drawn(kernels, s, count, s.world + 2 * kernels.margin(s)), count, side);
}

// One step of any game, as Gymnasium's environments count it.
export function advance(rules, s, action) {
  s.time += 1;
  const [reward, terminated] = rules.step(s, action);
  const truncated = s.time >= s.time_limit && !terminated;
  s.ended = Boolean(terminated) || truncated;
  return { reward: Number(reward), terminated: Boolean(terminated), truncated };
}
