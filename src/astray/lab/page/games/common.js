// Shared by the drawings of several games. World coordinates are cells, y upward.

import { common } from "../rules/constants.js";

// A brush that draws in cells on a canvas; top is the height of the world in cells.
export class Brush {
  constructor(paint, scale, top) {
    Object.assign(this, { paint, scale, top });
  }

  // A picture centred at (x, y), so many cells wide and high, turned clockwise by an angle.
  stamp(image, x, y, width = 1, height = width, flipped = false, angle = 0) {
    if (!image) return;
    const { paint, scale, top } = this;
    paint.save();
    paint.translate(x * scale, (top - y) * scale);
    if (flipped) paint.scale(-1, 1);
    paint.rotate(angle);
    paint.drawImage(
      image, (-width / 2) * scale, (-height / 2) * scale, width * scale, height * scale,
    );
    paint.restore();
  }

  // The pixels of the cell (x, y), without gaps between cells: left, up, width, height.
  #pixels(x, y) {
    const { scale, top } = this;
    const [left, right] = [Math.round(x * scale), Math.round((x + 1) * scale)];
    const [up, down] = [Math.round((top - y - 1) * scale), Math.round((top - y) * scale)];
    return [left, up, right - left, down - up];
  }

  // A picture that fills a cell.
  tile(image, x, y) {
    if (image) this.paint.drawImage(image, ...this.#pixels(x, y));
  }

  fill(colour, x, y) {
    this.paint.fillStyle = colour;
    this.paint.fillRect(...this.#pixels(x, y));
  }

  // Begins a path: through points, or around one.
  path(points) {
    this.paint.beginPath();
    points.forEach(([x, y], k) =>
      this.paint[k ? "lineTo" : "moveTo"](x * this.scale, (this.top - y) * this.scale));
  }

  // Begins a path around a square, from its lower left corner on.
  square(x, y, side) {
    this.path([[x, y], [x + side, y], [x + side, y + side], [x, y + side]]);
    this.paint.closePath();
  }

  circle(x, y, radius) {
    this.paint.beginPath();
    this.paint.arc(x * this.scale, (this.top - y) * this.scale, radius * this.scale, 0, 2 * Math.PI);
  }

  // Draws the path, in a width of so many cells, and pixels at least.
  stroke(style, width, least = 1.5, dashes = []) {
    const { paint, scale } = this;
    paint.setLineDash(dashes.map((length) => length * scale));
    paint.strokeStyle = style;
    paint.lineWidth = Math.max(least, width * scale);
    paint.stroke();
    paint.setLineDash([]);
  }

  shade(style) {
    this.paint.fillStyle = style;
    this.paint.fill();
  }

  letter(text, x, y, style, font) {
    const { paint, scale, top } = this;
    Object.assign(paint, { fillStyle: style, textAlign: "center", textBaseline: "middle" });
    paint.font = font.replace("1em", `${0.6 * scale}px`);
    paint.fillText(text, x * scale, (top - y) * scale);
  }
}

export function eachCell(grid, visit) {
  grid.forEach((row, y) => row.forEach((what, x) => visit(what, x, y)));
}

// The walls of a maze as a picture, and its floor in a colour.
export function drawMaze(brush, grid, wall, floor) {
  eachCell(grid, (what, x, y) => {
    if (what === common.WALL) brush.tile(wall, x, y);
    else brush.fill(floor, x, y);
  });
}

// Where an action leads by its name: [x, y], each -1, 0 or 1.
export function heading(name) {
  const x = name.startsWith("left") ? -1 : name.startsWith("right") ? 1 : 0;
  const y = /(^|-)up$/.test(name) ? 1 : /(^|-)down$/.test(name) ? -1 : 0;
  return [x, y];
}
