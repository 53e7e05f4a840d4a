// The agent's observation, and the parts of it that its value depends on.

import { fitted } from "./charts.js";
import { signed } from "./colours.js";

const PLANES = ["#4f5660", "#d2691e", "#8a6d1f", "#2fa393", "#b5446e", "#6b5b95", "#2e6db4"];

// seen: planes or an image; map: [C][H][W] or [H][W], or nothing. A sentence about it.
export function drawSight(canvas, seen, map) {
  const { paint, width } = fitted(canvas, canvas.parentElement.clientWidth);
  if (seen.planes) drawPlanes(paint, width, seen.planes);
  else drawImage(paint, width, seen.picture, seen.pixels);
  const flat = map && (typeof map[0][0] === "number" ? map.toReversed() : summed(map));
  if (flat) overlay(paint, width, flat);
  const what = seen.planes
    ? `${seen.planes.length} planes of ${seen.planes[0].length} x ${seen.planes[0][0].length} cells`
    : `an image of ${seen.side} x ${seen.side} pixels`;
  return flat ? `It sees ${what}. Blue: raises the value; brown: lowers it.` : `It sees ${what}.`;
}

function drawPlanes(paint, width, planes) {
  const [rows, columns] = [planes[0].length, planes[0][0].length];
  const side = width / columns;
  paint.fillStyle = "#f1efe8";
  paint.fillRect(0, 0, width, rows * side);
  planes.forEach((plane, c) => plane.forEach((row, y) => row.forEach((what, x) => {
    if (!what) return;
    const inset = c ? 0.12 + 0.05 * c : 0;
    paint.fillStyle = PLANES[c % PLANES.length];
    paint.fillRect((x + inset) * side, (rows - 1 - y + inset) * side,
      (1 - 2 * inset) * side + (c ? 0 : 0.5), (1 - 2 * inset) * side + (c ? 0 : 0.5));
  })));
}

function drawImage(paint, width, text, pixels) {
  const bytes = Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  const image = new ImageData(pixels, pixels);
  for (let k = 0; k < pixels * pixels; k++) {
    image.data.set([bytes[3 * k], bytes[3 * k + 1], bytes[3 * k + 2], 255], 4 * k);
  }
  const small = document.createElement("canvas");
  [small.width, small.height] = [pixels, pixels];
  small.getContext("2d").putImageData(image, 0, 0);
  paint.drawImage(small, 0, 0, width, width);
}

// All planes of a map together; as in them, the lowest row first.
function summed(map) {
  return map[0].map((row, y) => row.map((_, x) => map.reduce((sum, plane) => sum + plane[y][x], 0)));
}

function overlay(paint, width, map) {
  const most = Math.max(1e-12, ...map.flat().map(Math.abs));
  const side = width / map[0].length;
  map.forEach((row, y) => row.forEach((amount, x) => {
    paint.fillStyle = signed(amount / most, 0.15 + 0.7 * (Math.abs(amount) / most));
    if (Math.abs(amount) > 0.02 * most) {
      paint.fillRect(x * side, (map.length - 1 - y) * side, side + 0.5, side + 0.5);
    }
  }));
}
