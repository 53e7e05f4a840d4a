// Writes moving pictures as GIF: canvases in, bytes out.

const COLOURS = 256;

// frames: ImageData, all of one size; hundredths: of a second that each is shown.
export function writeGif(frames, hundredths) {
  const [{ width, height }] = frames;
  const palette = paletteOf(frames);
  const out = [..."GIF89a"].map((char) => char.charCodeAt(0));
  const short = (n) => out.push(n & 255, (n >> 8) & 255);
  [width, height].forEach(short);
  out.push(0xf7, 0, 0);
  for (let k = 0; k < COLOURS; k++) out.push(...(palette[k] ?? [0, 0, 0]));
  out.push(0x21, 0xff, 11, ...[..."NETSCAPE2.0"].map((char) => char.charCodeAt(0)), 3, 1, 0, 0, 0);
  const nearest = new Map();
  for (const frame of frames) {
    out.push(0x21, 0xf9, 4, 0);
    short(hundredths);
    out.push(0, 0, 0x2c, 0, 0, 0, 0);
    [width, height].forEach(short);
    out.push(0, 8);
    const packed = compress(indices(frame.data, palette, nearest));
    for (let at = 0; at < packed.length; at += 255) {
      const part = packed.slice(at, at + 255);
      out.push(part.length, ...part);
    }
    out.push(0);
  }
  return Uint8Array.from([...out, 0x3b]);
}

const rough = (data, at) => ((data[at] >> 3) << 10) | ((data[at + 1] >> 3) << 5) | (data[at + 2] >> 3);

// The commonest colours of all frames, of 5 bits each.
function paletteOf(frames) {
  const counts = new Map();
  for (const { data } of frames) {
    for (let at = 0; at < data.length; at += 16) {
      const key = rough(data, at);
      counts.set(key, (counts.get(key) ?? 0) + 1);
    }
  }
  const common = [...counts].sort((one, two) => two[1] - one[1]).slice(0, COLOURS);
  return common.map(([key]) => [key >> 10, (key >> 5) & 31, key & 31].map((n) => (n << 3) | (n >> 2)));
}

function indices(data, palette, nearest) {
  const found = new Uint8Array(data.length / 4);
  for (let at = 0; at < data.length; at += 4) {
    const key = rough(data, at);
    if (!nearest.has(key)) nearest.set(key, nearestOf(palette, data, at));
    found[at / 4] = nearest.get(key);
  }
  return found;
}

function nearestOf(palette, data, at) {
  let [best, least] = [0, Infinity];
  palette.forEach(([r, g, b], k) => {
    const away = (r - data[at]) ** 2 + (g - data[at + 1]) ** 2 + (b - data[at + 2]) ** 2;
    if (away < least) [best, least] = [k, away];
  });
  return best;
}

// Lempel-Ziv-Welch as GIF has it, with codes of 9 to 12 bits.
function compress(pixels) {
  const [clear, end] = [256, 257];
  const out = [];
  let [bits, held, size, next, codes] = [0, 0, 9, 258, new Map()];
  const write = (code) => {
    held |= code << bits;
    bits += size;
    while (bits >= 8) {
      out.push(held & 255);
      held >>>= 8;
      bits -= 8;
    }
  };
  write(clear);
  let prefix = pixels[0];
  for (let k = 1; k < pixels.length; k++) {
    const key = prefix * 256 + pixels[k];
    if (codes.has(key)) {
      prefix = codes.get(key);
      continue;
    }
    write(prefix);
    if (next < 4096) {
      codes.set(key, next);
      if (next === 1 << size && size < 12) size += 1;
      next += 1;
    } else {
      write(clear);
      [size, next, codes] = [9, 258, new Map()];
    }
    prefix = pixels[k];
  }
  write(prefix);
  write(end);
  if (bits) out.push(held & 255);
  return out;
}
