// Shared by the rules of all games: actions, cells, ways, and sentences about levels.
// All constants are Python's: `astray.lab.constants` writes the module that has them. So is the step
// of each game: `astray.lab.translate` writes rules/NAME-step.js.

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

// One step of any game, as Gymnasium's environments count it.
export function advance(rules, s, action) {
  s.time += 1;
  const [reward, terminated] = rules.step(s, action);
  const truncated = s.time >= s.time_limit && !terminated;
  s.ended = Boolean(terminated) || truncated;
  return { reward: Number(reward), terminated: Boolean(terminated), truncated };
}
