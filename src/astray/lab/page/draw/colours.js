// Colours that every kind of colour vision tells apart: those of the reports' figures.

import { goals as words } from "../rules/constants.js";
export { words };

export const INTENDED = "#2fa393";
export const PROXY = "#f0a03c";
const OTHERS = ["#2e6db4", "#b5446e", "#6b5b95", "#8a6d1f"];

// The colour of each goal of a shift, of "neither" and of "another cell".
export function goalColours(shift, goals = []) {
  const colours = { [words.NEITHER]: "#b9b9b2", [words.OTHER]: "#b9b9b2" };
  if (!shift) return colours;
  const named = [shift.intended, ...shift.proxies];
  colours[shift.intended] = INTENDED;
  shift.proxies.forEach((proxy, k) => { colours[proxy] = k ? OTHERS[k - 1] : PROXY; });
  goals.filter((goal) => !(goal in colours) && !named.includes(goal))
    .forEach((goal, k) => { colours[goal] = OTHERS[k % OTHERS.length]; });
  return colours;
}

// From pale to dark in one hue, for rates from 0 to 1; and between two hues, from -1 to 1.
const PALE = [247, 244, 232];
const DARK = [20, 96, 122];
const WARM = [176, 72, 10];

export function heat(rate, alpha = 1) {
  return mixed(PALE, DARK, rate, alpha);
}

export function signed(amount, alpha = 1) {
  return mixed(PALE, amount < 0 ? WARM : DARK, Math.min(Math.abs(amount), 1), alpha);
}

function mixed(from, to, rate, alpha) {
  const [r, g, b] = from.map((low, k) => Math.round(low + rate * (to[k] - low)));
  return `rgba(${r}, ${g}, ${b}, ${alpha})`;
}

// A custom property of the page's style, as the theme has it now.
export function themed(element, name) {
  return getComputedStyle(element).getPropertyValue(name).trim();
}
