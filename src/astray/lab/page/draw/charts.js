// Curves of an episode: fractions of goals that add up to 1, and values with advantages and events.

import { rewards as clipped } from "../rules/constants.js";
import { rounded } from "../parts.js";
import { themed } from "./colours.js";

const EDGE = 8; // pixels around a chart
const AXIS = 42; // pixels of the numbers at its left
const INK = "#22231f"; // on the colours of goals, in both themes
const { CLIP } = clipped; // of divided rewards

// A canvas as sharp as the screen; its size in CSS pixels.
export function fitted(canvas, height) {
  const width = Math.max(120, canvas.parentElement.clientWidth);
  const ratio = globalThis.devicePixelRatio || 1;
  canvas.style.height = `${height}px`;
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const paint = canvas.getContext("2d");
  paint.setTransform(ratio, 0, 0, ratio, 0, 0);
  paint.clearRect(0, 0, width, height);
  paint.font = "11px system-ui, sans-serif";
  return { paint, width, height };
}

function frame(canvas, height, last) {
  const { paint, width } = fitted(canvas, height);
  const across = (t) => AXIS + (t / Math.max(last, 1)) * (width - AXIS - EDGE);
  return { paint, width, across };
}

// A line through points [[x, y], ...].
function stroke(paint, points, colour, width, dashes = []) {
  paint.setLineDash(dashes);
  paint.strokeStyle = colour;
  paint.lineWidth = width;
  paint.beginPath();
  points.forEach(([x, y], k) => paint[k ? "lineTo" : "moveTo"](x, y));
  paint.stroke();
}

// goals: {name: [T + 1]}, stacked from below; agent: [T + 1] or null, a dashed line.
export function drawPosterior(canvas, { goals, agent }, colours, now) {
  const height = 150;
  const last = Object.values(goals)[0].length - 1;
  const { paint, width, across } = frame(canvas, height, last);
  const [ink, soft, line] = ["--ink", "--soft", "--line"].map((name) => themed(canvas, name));
  const down = (rate) => EDGE + (1 - rate) * (height - 2 * EDGE - 14);
  let below = new Array(last + 1).fill(0);
  for (const [goal, rates] of Object.entries(goals)) {
    const above = rates.map((rate, t) => below[t] + rate);
    paint.beginPath();
    paint.moveTo(across(0), down(below[0]));
    above.forEach((rate, t) => paint.lineTo(across(t), down(rate)));
    for (let t = last; t >= 0; t--) paint.lineTo(across(t), down(below[t]));
    paint.closePath();
    paint.fillStyle = colours[goal] ?? soft;
    if (last === 0) paint.fillRect(across(0), down(above[0]), width - AXIS - EDGE, down(below[0]) - down(above[0]));
    else paint.fill();
    below = above;
  }
  if (agent) stroke(paint, agent.map((rate, t) => [across(t), down(rate)]), INK, 1.6, [4, 3]);
  axis(paint, [[0, "0 %"], [0.5, "50 %"], [1, "100 %"]], down, soft, line, width);
  steps(paint, last, across, height, soft, ink, now);
}

function axis(paint, marks, down, soft, line, width) {
  paint.fillStyle = soft;
  paint.textAlign = "right";
  paint.textBaseline = "middle";
  for (const [amount, text] of marks) {
    paint.fillText(text, AXIS - 4, down(amount));
    stroke(paint, [[AXIS, down(amount)], [width - EDGE, down(amount)]], line, 0.5);
  }
}

// The first step, the last, and a line at the one that is shown.
function steps(paint, last, across, height, soft, ink, now) {
  const x = across(Math.min(now, last));
  paint.fillStyle = soft;
  paint.textBaseline = "alphabetic";
  paint.textAlign = "left";
  paint.fillText("step 0", across(0), height - 2);
  paint.textAlign = "right";
  if (last > 0) paint.fillText(String(last), across(last), height - 2);
  stroke(paint, [[x, 18], [x, height - 14]], ink, 1); // below the names
}

// The value of every step as a curve, advantages as bars, events as marks with their names.
export function drawTimeline(canvas, { value, advantage, events, last }, now) {
  const height = 170;
  const { paint, width, across } = frame(canvas, height, last);
  const names = ["--ink", "--soft", "--line", "--held", "--not"];
  const [ink, soft, line, good, bad] = names.map((name) => themed(canvas, name));
  const [low, high] = [Math.min(0, ...value), Math.max(1e-6, ...value)];
  const down = (v) => 22 + (1 - (v - low) / (high - low || 1)) * 78;
  axis(paint, [[low, rounded(low, 1)], [high, rounded(high, 1)]], down, soft, line, width);
  stroke(paint, value.map((v, t) => [across(t), down(v)]), ink, 1.6);
  const most = Math.max(1e-6, ...advantage.map(Math.abs));
  const [middle, reach] = [128, 22];
  const thick = Math.max(1, ((width - AXIS - EDGE) / Math.max(last, 1)) * 0.7);
  advantage.forEach((a, t) => {
    paint.fillStyle = a < 0 ? bad : good;
    const tall = (reach * a) / most;
    paint.fillRect(across(t + 0.5) - thick / 2, middle - Math.max(tall, 0), thick, Math.abs(tall));
  });
  paint.fillStyle = soft;
  paint.textAlign = "left";
  paint.textBaseline = "middle";
  paint.fillText("value", AXIS, 10);
  let right = AXIS + 44;
  for (const { name, step } of events) {
    stroke(paint, [[across(step), 18], [across(step), height - 16]], soft, 1.6, [2, 3]);
    const wide = paint.measureText(name).width;
    const x = Math.min(Math.max(across(step) - 20, right), width - wide - 4);
    if (x < right || x > across(step)) continue; // its button below names it
    paint.fillText(name, x, 10);
    right = x + wide + 10;
  }
  paint.save();
  paint.translate(10, middle);
  paint.rotate(-Math.PI / 2);
  paint.textAlign = "center";
  paint.fillText("adv.", 0, 4);
  paint.restore();
  steps(paint, last, across, height, soft, ink, now);
}

// The step at a place of a chart, from its left edge in pixels.
export function stepAt(canvas, x, last) {
  const rate = (x - AXIS) / (canvas.clientWidth - AXIS - EDGE);
  return Math.round(Math.min(Math.max(rate, 0), 1) * last);
}

// Rewards as a critic was trained with them, whose values are of these; as they are where nobody
// knows the deviation of returns, null.
export function divided(rewards, deviation) {
  if (!deviation) return rewards;
  return rewards.map((reward) => Math.min(Math.max(reward / deviation, -CLIP), CLIP));
}

// Generalised advantage estimates of an episode (Schulman et al. 2016), [T].
export function advantages(value, rewards, terminated, gamma, lam) {
  const found = new Array(rewards.length).fill(0);
  let carry = 0;
  for (let t = rewards.length - 1; t >= 0; t--) {
    const after = terminated && t === rewards.length - 1 ? 0 : value[t + 1];
    carry = rewards[t] + gamma * after - value[t] + gamma * lam * carry;
    found[t] = carry;
  }
  return found;
}
