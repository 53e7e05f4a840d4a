// Drawing of Heist, and of Keys and Chests: a thief, and things in the cells of a maze.

import { drawMaze, heading } from "./common.js";
import { thief as body } from "../rules/constants.js";

const FLOORS = "#e9e4dc";

// thing: the picture of a thing and its size in cells; hand: the pictures of what is in hand.
export const look = (thing, hand) => ({
  direction: heading, agent: "thief", proxies: () => ({}),
  still: (brush, { grid }, s, pictures) => drawMaze(brush, grid, pictures.get("wall-brick"), FLOORS),
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

function thief(brush, s, pictures) {
  const [dx, dy] = body.PUSHES[s.facing];
  const oblique = dx !== 0 && dy !== 0;
  const image = pictures.get(oblique ? "thief-right-up" : "thief-right");
  const quarters = Math.floor(((2 * Math.atan2(dy, dx)) / Math.PI + 4) % 4);
  brush.stamp(image, s.x, s.y, 2 * body.HALF, 2 * body.HALF, false, (-quarters * Math.PI) / 2);
}
