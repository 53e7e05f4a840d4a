// Python's operations, for kernels that `astray.lab.translate` translates.

export const mod = (a, b) => { const left = (a % b) + 0; return left * b < 0 ? left + b : left; };
export const floorDiv = (a, b) => Math.round((a - mod(a, b)) / b);
export const bitOr = (a, b) => Number(BigInt(a) | BigInt(b));
export const bitAnd = (a, b) => Number(BigInt(a) & BigInt(b));
export const shiftLeft = (a, b) => exact(Number(BigInt(a) << BigInt(b)));
export const shiftRight = (a, b) => Number(BigInt(a) >> BigInt(b));
export const from = (at, rows) => (at < 0 ? at + rows.length : at); // as in Python
export const yes = (x) => (Array.isArray(x) ? x.length > 0 : x !== x || Boolean(x));
export const or = (one, other) => (yes(one) ? one : other());
export const and = (one, other) => (yes(one) ? other() : one);
export const same = (a, b) => (
  Array.isArray(a) ? a.length === b.length && a.every((x, k) => same(x, b[k])) : a == b);
export const isIn = (one, several) => several.some((x) => same(x, one));
export const kept = (x, n) => typeof x === "bigint" ? kept(Number(BigInt.asUintN(32, x)), n)
  : n > 0 ? x << 32 - n >>> 32 - n : x << 32 + n >> 32 + n; // n bits
export const wide = (x) => BigInt.asUintN(64, BigInt(x)); // an integer without a sign

export function exact(number) {
  if (!Number.isInteger(number) || Number.isSafeInteger(number)) return number;
  throw new Error("the rules come to an integer above 2 ** 53, which needs Python: astray lab");
}
export const natural = (x) => (x < 0 ? exact(2 ** 64) : x); // of integers without a sign

const axes = (x) => (Array.isArray(x) ? 1 + axes(x[0]) : 0);
export function fill(rows, value, as = (x) => x) {
  const each = axes(value) === axes(rows); // or all parts get the same
  rows.forEach((row, y) => {
    const part = each ? value[y] : value;
    if (typeof row === "object") fill(row, part, as); else rows[y] = as(part);
  });
}

export function where(layer, ...codes) {
  const found = [];
  layer.forEach((row, y) => row.forEach((what, x) => codes.includes(what) && found.push([x, y])));
  return found;
}
