// The levels of Heist and of Keys and Chests: `astray.kernel.thief` without Python.

import { NEVER, WALL, lay, world } from "./common.js";

export const f = Math.fround;

// Fills the state of a level with the things of its grid.
export function begin(game, s, p, { grid, cell, looks }) {
  game.furnish(s, p);
  const objects = [];
  for (let x = 0; x < grid.length; x++) {
    for (let y = 0; y < grid.length; y++) if (grid[y][x] > WALL) objects.push([x, y]);
  }
  if (objects.length > s.what.length) {
    throw new Error(`a level has at most ${s.what.length} things; this has ${objects.length}`);
  }
  lay(s, grid, (what) => Number(what === WALL));
  [s.x, s.y] = [cell[0] + 0.5, cell[1] + 0.5];
  s.background = looks.background ?? Math.max(p.background, 0);
  s.background_offset = looks.background_offset ?? 0;
  [s.twister, s.twister_at] = looks.twister ?? [NEVER, 0];
  game.wind(s, Math.max(s.twister, 0), s.twister_at);
  for (const [x, y] of objects) game.put(s, grid[y][x], x, y);
  if (looks.details) { // where things are in their cells
    const gone = looks.details.find(([x, y]) => !(grid[y]?.[x] > WALL));
    if (gone) throw new Error(`a level's looks tell of a thing at cell (${gone[0]}, ${gone[1]}), which has none`);
    const beside = new Map(looks.details.map(([x, y, ...where]) => [`${x},${y}`, where]));
    objects.forEach(([x, y], k) => {
      const [right, up] = beside.get(`${x},${y}`) ?? [0.5, 0.5];
      [s.object_x[k], s.object_y[k]] = [f(x + right), f(y + up)];
    });
  }
}

// The codes of the cells, without objects that are gone.
export function contents(s) {
  const cells = world(s, s.cell);
  for (let k = 0; k < s.objects; k++) {
    if (s.gone[k] < 0) cells[Math.trunc(s.object_y[k])][Math.trunc(s.object_x[k])] = s.what[k];
  }
  return cells;
}
