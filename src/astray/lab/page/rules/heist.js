// Heist: its levels, without Python.

import { cellsOf } from "../level.js";
import { NEVER, observedMaze, rulesOf } from "./common.js";
import { heist } from "./constants.js";
import { game } from "./heist-kernels.js";
import { distances } from "./kernels.js";
import { begin, contents } from "./thief.js";

const { COLOURS, PLANES } = heist;

export const rules = rulesOf(game, {
  build, contents, reach, planes: (s) => observedMaze(game, s, PLANES),
});

function build(s, p, level) {
  begin(game, s, p, level);
  for (const name of level.looks.hand ?? []) {
    if (!COLOURS.includes(name)) throw new Error(`unknown key '${name}'; there are: ${COLOURS.join(", ")}`);
    s.hand |= 1 << COLOURS.indexOf(name);
  }
  s.keys |= s.hand;
  s.all_keys = s.hand && s.hand === s.keys ? 0 : NEVER;
}

// Steps from the thief with the keys on its way.
function reach(s) {
  const cells = contents(s);
  for (let [hand, before] = [s.hand, NEVER]; ;) {
    const open = cells.map((row, y) => row.map((_, x) => game.hand_in(cells, hand, x, y) !== NEVER));
    const steps = distances(open, Math.floor(s.x), Math.floor(s.y));
    if (hand === before) return steps;
    before = hand;
    for (const [x, y] of cellsOf(steps.map((row) => row.map((away) => away >= 0)), true)) {
      hand = game.hand_in(cells, hand, x, y);
    }
  }
}
