// How the lab draws a game that it does not know: its cells, with the characters of its drawings.

import { eachCell } from "./common.js";

const FILLS = { ".": "#f1efe8", "#": "#8d8a80" };

export const look = { still, moving, direction, wall: 1, proxies: () => ({}), plain: true };

function still(brush, level, s, pictures, legend) {
  const chars = Object.fromEntries(Object.entries(legend).map(([char, code]) => [code, char]));
  const { paint, scale, top } = brush;
  eachCell(s.grid ?? level.grid, (what, x, y) => {
    const char = chars[what] ?? "?";
    brush.fill(FILLS[char] ?? FILLS["."], x, y);
    if (FILLS[char]) return;
    paint.fillStyle = "#333";
    paint.font = `600 ${0.6 * scale}px ui-monospace, monospace`;
    paint.textAlign = "center";
    paint.textBaseline = "middle";
    paint.fillText(char, (x + 0.5) * scale, (top - y - 0.47) * scale);
  });
}

function moving(brush, level, s) {
  const [x, y] = s.agent ?? [s.x, s.y];
  const { paint, scale, top } = brush;
  paint.fillStyle = "#14776f";
  paint.beginPath();
  paint.arc(x * scale, (top - y) * scale, 0.34 * scale, 0, 2 * Math.PI);
  paint.fill();
}

function direction(name) {
  const x = name.startsWith("left") ? -1 : name.startsWith("right") ? 1 : 0;
  const y = /(^|-)up$/.test(name) ? 1 : /(^|-)down$/.test(name) ? -1 : 0;
  return [x, y];
}
