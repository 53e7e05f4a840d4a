// Drawing of Keys and Chests in the lab.

import { look as thief } from "./thief.js";
import { keys } from "../rules/constants.js";

const { KEY } = keys;
const isKey = (s, k) => s.what[k] === KEY;

export const look = thief(
  (s, k, pictures) => [pictures.get(isKey(s, k) ? "key" : "chest"), isKey(s, k) ? 0.8 : 1],
  (s, pictures) => Array(s.taken - s.opened).fill(pictures.get("icon")),
);
