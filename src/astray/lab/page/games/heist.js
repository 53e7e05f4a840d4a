// Drawing of Heist in the lab.

import { look as thief } from "./thief.js";
import { heist } from "../rules/constants.js";

const { COLOURS, KEY, DOOR_CODE, GEM } = heist;

export const look = thief(
  (s, k, pictures) => {
    if (s.what[k] === GEM) return [pictures.get("gem"), 1];
    const [name, first] = s.what[k] >= DOOR_CODE ? ["door", DOOR_CODE] : ["key", KEY];
    return [pictures.tint(name, COLOURS[s.what[k] - first]), 1];
  },
  (s, pictures) => COLOURS.filter((_, k) => (s.hand >> k) & 1).map((colour) => pictures.tint("icon", colour)),
);
