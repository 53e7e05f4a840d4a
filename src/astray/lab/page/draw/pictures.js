// Drawings of a game, ready to be drawn on a canvas.

import { common } from "../rules/constants.js";

export class Pictures {
  // drawings: SVG by name; changed: called when one more can be drawn.
  constructor(drawings, changed) {
    this.tinted = new Map();
    this.images = new Map();
    for (const [name, svg] of Object.entries(drawings)) {
      const image = new Image();
      image.onload = changed;
      image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg)}`;
      this.images.set(name, image);
    }
  }

  get(name) {
    const image = this.images.get(name);
    return image?.complete && image.naturalWidth ? image : null;
  }

  // A white drawing in a colour of the game's.
  tint(name, colour) {
    const key = `${name} ${colour}`;
    const image = this.get(name);
    if (!image) return null;
    if (!this.tinted.has(key)) {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
      const paint = canvas.getContext("2d");
      paint.drawImage(image, 0, 0);
      paint.globalCompositeOperation = "multiply";
      paint.fillStyle = `rgb(${common.COLOURS[colour] ?? [255, 255, 255]})`;
      paint.fillRect(0, 0, canvas.width, canvas.height);
      paint.globalCompositeOperation = "destination-in";
      paint.drawImage(image, 0, 0);
      this.tinted.set(key, canvas);
    }
    return this.tinted.get(key);
  }
}
