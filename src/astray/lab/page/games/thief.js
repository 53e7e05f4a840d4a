// Drawing of Heist, and of Keys and Chests: a thief, and things in the cells of a maze.

import { eachCell, heading } from "./common.js";
import { WALL, push } from "../rules/common.js";

const FLOORS = "#e9e4dc";

// thing: the picture of a thing and its size in cells; hand: the pictures of what is in hand.
export const look = (thing, hand) => ({
  still, direction: heading, agent: "thief", wall: WALL, proxies: () => ({}),
  moving(brush, level, s, pictures) {
    for (let k = 0; k < s.objects; k++) {
      if (s.gone[k] >= 0) continue;
      const [image, size] = thing(s, k, pictures);
      brush.stamp(image, s.object_x[k], s.object_y[k], size);
    }
    thief(brush, s, pictures);
    hand(s, pictures).forEach((icon, slot) => {
      brush.stamp(icon, s.world - 0.5 - 0.45 * slot, s.world - 0.5, 0.34, 0.45);
    });
  },
});

function still(brush, { grid }, s, pictures) {
  const wall = pictures.get("wall-brick");
  eachCell(grid, (what, x, y) => {
    if (what === WALL) brush.tile(wall, x, y);
    else brush.fill(FLOORS, x, y);
  });
}

function thief(brush, s, pictures) {
  const { paint, scale, top } = brush;
  const [dx, dy] = push(s.facing);
  const oblique = dx !== 0 && dy !== 0;
  const image = pictures.get(oblique ? "thief-right-up" : "thief-right");
  const quarters = oblique
    ? { "1,1": 0, "-1,1": 1, "-1,-1": 2, "1,-1": 3 }[`${dx},${dy}`]
    : { "1,0": 0, "0,1": 1, "-1,0": 2, "0,-1": 3 }[`${dx},${dy}`];
  if (!image) return;
  paint.save();
  paint.translate(s.x * scale, (top - s.y) * scale);
  paint.rotate((-(quarters ?? 0) * Math.PI) / 2);
  paint.drawImage(image, -0.375 * scale, -0.375 * scale, 0.75 * scale, 0.75 * scale);
  paint.restore();
}
