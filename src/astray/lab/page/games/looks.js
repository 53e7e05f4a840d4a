// The drawing of each game.

import { look as any } from "./any.js";
import { look as coinrun } from "./coinrun.js";
import { look as heist } from "./heist.js";
import { look as keys } from "./keys.js";
import { look as maze } from "./maze.js";

const LOOKS = { __proto__: null, coinrun, heist, keys, maze };

export const lookOf = (game) => LOOKS[game] ?? any;
