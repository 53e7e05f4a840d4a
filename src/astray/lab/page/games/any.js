// Drawing of a game of cells: with its sprites, or else the characters of its drawings.

import { eachCell, heading } from "./common.js";
import { WALL } from "../rules/common.js";

const FILLS = { ".": "#f1efe8", "#": "#8d8a80" };

export const look = { still, moving, direction: heading, wall: WALL, proxies: () => ({}), plain: true };

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
    else if (!FILLS[char]) letter(brush, char, x, y);
    if (char === "#") names.forEach((name) => brush.tile(pictures.get(name), x, y));
  });
}

function letter({ paint, scale, top }, char, x, y) {
  paint.fillStyle = "#333";
  paint.font = `600 ${0.6 * scale}px ui-monospace, monospace`;
  paint.textAlign = "center";
  paint.textBaseline = "middle";
  paint.fillText(char, (x + 0.5) * scale, (top - y - 0.47) * scale);
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
  const { paint, scale, top } = brush;
  paint.fillStyle = "#14776f";
  paint.beginPath();
  paint.arc(x * scale, (top - y) * scale, 0.34 * scale, 0, 2 * Math.PI);
  paint.fill();
}
