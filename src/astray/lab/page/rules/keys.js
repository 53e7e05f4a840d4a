// Keys and Chests: its levels, without Python.

import { WALL, observedMaze, rulesOf, world } from "./common.js";
import { keys } from "./constants.js";
import { game } from "./keys-kernels.js";
import { begin, contents } from "./thief.js";

export const rules = rulesOf(game, {
  build: (...level) => begin(game, ...level), contents,
  open: (s) => world(s, s.cell).map((row) => row.map((what) => what !== WALL)),
  planes: (s) => observedMaze(game, s, keys.PLANES),
});
