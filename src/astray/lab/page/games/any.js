// Drawing of a game of cells: with its sprites, or else the characters of its drawings.

import { eachCell, heading } from "./common.js";

const FILLS = { ".": "#f1efe8", "#": "#8d8a80" };

export const look = { still, moving, direction: heading, proxies: () => ({}), plain: true };

// Visit each cell: `visit` is called with the names of drawings, or with a character alone.
function each(level, s, { legend, pictures = {} }, visit) {
  const chars = Object.fromEntries(Object.entries(legend).map(([char, code]) => [code, char]));
  eachCell(s.grid ?? level.grid, (what, x, y) => {
    const char = chars[what] ?? "?";
    visit(pictures[char] ?? [], char, x, y);
  });
}

function still(brush, level, s, pictures, rules) {
  const { floors = [] } = rules;
  each(level, s, rules, (names, char, x, y) => {
    brush.fill(FILLS[char] ?? FILLS["."], x, y);
    if (floors.length) brush.tile(pictures.get(floors[(x + y) % floors.length]), x, y);
    else if (!FILLS[char]) brush.letter(char, x + 0.5, y + 0.47, "#333", "600 1em ui-monospace, monospace");
    if (char === "#") names.forEach((name) => brush.tile(pictures.get(name), x, y));
  });
}

function moving(brush, level, s, pictures, rules) {
  each(level, s, rules, (names, char, x, y) => {
    if (char !== "#") names.forEach((name) => brush.stamp(pictures.get(name), x + 0.5, y + 0.5));
  });
  const [x, y] = s.agent ?? [s.x, s.y];
  if (s.picture) {
    brush.stamp(pictures.get(s.picture), x, y);
    return;
  }
  brush.circle(x, y, 0.34);
  brush.shade("#14776f");
}
