// Files to take along: links, pictures, videos, levels.

import { plain } from "./level.js";
import { toLink } from "./link.js";
import { writeGif } from "./gif.js";

const PIXELS = 384; // of the longer side of a GIF
const MOST_FRAMES = 300;

export const save = {
  async link(lab) {
    const address = new URL(await toLink(lab), location.href).href;
    await navigator.clipboard.writeText(address);
    lab.panels.status("The link was copied.");
  },

  png(lab) {
    lab.part("world").toBlob((blob) => offer(blob, `${nameOf(lab)}.png`));
  },

  async gif(lab) {
    const { columns, rows, left, low } = lab.stage.frame;
    const scale = Math.max(4, Math.floor(PIXELS / Math.max(columns, rows)));
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [columns * scale, rows * scale];
    const paint = canvas.getContext("2d", { willReadFrequently: true });
    const { states } = lab.episode;
    const frames = states.slice(0, MOST_FRAMES).map((state) => {
      paint.setTransform(1, 0, 0, 1, -left * scale, low * scale);
      lab.stage.paintWorld(paint, scale, rows, state);
      return paint.getImageData(0, 0, canvas.width, canvas.height);
    });
    offer(new Blob([writeGif(frames, 8)], { type: "image/gif" }), `${nameOf(lab)}.gif`);
    if (states.length > MOST_FRAMES) lab.panels.status(`The GIF has the first ${MOST_FRAMES} of ${states.length} states.`);
  },

  json(lab) {
    const text = JSON.stringify({ game: lab.game, ...plain(lab.level) });
    offer(new Blob([text], { type: "application/json" }), `${nameOf(lab)}.json`);
  },

  async read(lab) {
    const text = lab.part("text").value;
    const level = text.trim().startsWith("{") ? JSON.parse(text) : text;
    if (await lab.open(level)) lab.part("text").blur();
  },
};

const nameOf = ({ game, variant, number }) => `${game}-${variant}-${number ?? "drawn"}`;

function offer(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
