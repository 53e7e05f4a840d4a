// Shared by the rules of all grid worlds: `astray.grid`, for a page without Python.
//
// `astray.lab.rules` writes each world's own part, worlds/NAME.js, from its Python.

import { NEVER, observed, rulesOf } from "./common.js";
import { grid as counted } from "./constants.js";

const { OVER } = counted;

export function gridRules(game) {
  const [count, seen] = game.planes;
  const contents = (s) =>
    s.cell.map((row, y) => row.map((what, x) => what + OVER * s.mover[y][x]));

  function build(s, p, { grid, cell, looks }) {
    const side = s.cell.length;
    if (grid.length !== side || grid[0].length !== side) {
      throw new Error(`the level is (${grid.length}, ${grid[0].length}); it must be ${side} cells a side`);
    }
    s.cell = grid.map((row) => row.map((what) => what % OVER));
    s.mover = grid.map((row) => row.map((what) => Math.floor(what / OVER)));
    [s.x, s.y] = cell;
    game.settle(s);
    game.furnish?.(s, p);
    for (const [name, usual] of Object.entries(game.looks)) s[name] = looks[name] ?? usual;
  }

  // The cell of a goal; null where it has none, or moves.
  function target(s, goal) {
    const [x, y] = game[`target ${goal}`]?.(s) ?? [NEVER];
    return x === NEVER ? null : [x, y];
  }

  const open = (s) => s.cell.map((row) => row.map((what) => !game.solid.includes(what)));
  const planes = (s) => observed(game, s, null, count, seen);
  const rules = rulesOf(game, { build, contents, open, planes });
  const view = (s) => ({ agent: rules.centre(s), picture: game.agents[s.held], grid: contents(s) });
  return { ...rules, view, target };
}
