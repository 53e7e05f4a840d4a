// Python's operations, for kernels that `astray.lab.translate` translates.

export const floorDiv = (a, b) => Math.floor(a / b);
export const mod = (a, b) => a - b * Math.floor(a / b);
export const bitOr = (a, b) => Number(BigInt(a) | BigInt(b));
export const bitAnd = (a, b) => Number(BigInt(a) & BigInt(b));
export const shiftLeft = (a, b) => exact(Number(BigInt(a) << BigInt(b)));
export const shiftRight = (a, b) => Number(BigInt(a) >> BigInt(b));
export const from = (at, rows) => (at < 0 ? at + rows.length : at); // as in Python
export const yes = (x) => (Array.isArray(x) ? x.length > 0 : Boolean(x));
export const or = (one, other) => (yes(one) ? one : other());
export const and = (one, other) => (yes(one) ? other() : one);
export const same = (a, b) => (Array.isArray(a) ? String(a) === String(b) : a == b);
export const wide = (x) => BigInt.asUintN(64, BigInt(x)); // an integer without a sign

export function exact(number) {
  if (!Number.isInteger(number) || Number.isSafeInteger(number)) return number;
  throw new Error("the rules multiply to an integer above 2 ** 53, which needs Python: astray lab");
}

export function fill(rows, value) {
  rows.forEach((row, y) => { if (typeof row === "object") fill(row, value); else rows[y] = value; });
}

export function copyFlat(target, source) {
  target.forEach((row, y) => {
    if (typeof row === "object") copyFlat(row, source[y]); else target[y] = source[y];
  });
}

export function where(layer, ...codes) {
  const found = [];
  layer.forEach((row, y) => row.forEach((what, x) => codes.includes(what) && found.push([x, y])));
  return found;
}
