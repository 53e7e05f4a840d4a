// Kernels in WebAssembly, which `astray.lab.wasm` compiles, as functions of JavaScript.
//
// States are objects with numbers, truths and rows of rows; integers of 64 bits are numbers up to
// 2 ** 53, and BigInt above. Arrays are objects {shape, data}, or rows of rows that no kernel changes.

const PAGE = 65536; // bytes
const STACK = 16 * PAGE;
const MADE = 32; // bytes in front of an array that a kernel makes: numba's MemInfo
const DATA = 16; // in which the array's address is here

const whole = (x) => BigInt(typeof x === "number" ? Math.trunc(x) : x);
const exact = (x) => (Number.isSafeInteger(Number(x)) ? Number(x) : x);
const kind = (size, name, put = Number, take = (x) => x) =>
  [size, (v, at, x) => v[`set${name}`](at, put(x), true), (v, at) => take(v[`get${name}`](at, true))];
// NumPy's code of a type: [its bytes, what writes one, what reads one].
const KINDS = {
  b1: kind(1, "Uint8", Boolean, Boolean), f4: kind(4, "Float32"), f8: kind(8, "Float64"),
  i1: kind(1, "Int8"), i2: kind(2, "Int16"), i4: kind(4, "Int32"), i8: kind(8, "BigInt64", whole, exact),
  u1: kind(1, "Uint8"), u2: kind(2, "Uint16"), u4: kind(4, "Uint32"), u8: kind(8, "BigUint64", whole, exact),
};

// Functions of the names in `about`, which says what they take and return; text: base64.
export async function kernels(text, about) {
  const bytes = Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  const memory = new WebAssembly.Memory({ initial: 1 + (2 * STACK) / PAGE });
  const top = memory.buffer.byteLength - PAGE; // of the stack, which grows towards what is constant
  let heap = top;
  const view = () => new DataView(memory.buffer);

  function allocate(size) {
    const at = heap;
    heap = (at + size + 15) & ~15;
    const lacking = heap - memory.buffer.byteLength;
    if (lacking > 0) memory.grow(Math.ceil(lacking / PAGE));
    return at;
  }

  function made(size) {
    const at = allocate(Number(size) + MADE);
    view().setUint32(at + DATA, at + MADE, true);
    return at;
  }

  // Arrays that are shaped anew are in C's order; 0 says that another is not.
  function reshaped(axes, dims, strides, newAxes, newDims, newStrides, itemsize) {
    const [v, at] = [view(), (where, k) => Number(view().getBigInt64(where + 8 * k, true))];
    let step = Number(itemsize);
    for (let k = Number(axes) - 1; k >= 0; step *= at(dims, k--)) {
      if (at(dims, k) !== 1 && at(strides, k) !== step) return 0;
    }
    step = Number(itemsize);
    for (let k = Number(newAxes) - 1; k >= 0; step *= at(newDims, k--)) {
      v.setBigInt64(newStrides + 8 * k, BigInt(step), true);
    }
    return 1;
  }

  const { instance } = await WebAssembly.instantiate(bytes, { env: {
    __linear_memory: memory,
    __indirect_function_table: new WebAssembly.Table({ initial: 64, element: "anyfunc" }),
    __stack_pointer: new WebAssembly.Global({ value: "i32", mutable: true }, top),
    __multi3(at, a, aHigh, b, bHigh) { // of integers of 128 bits
      const [x, y] = [[a, aHigh], [b, bHigh]].map(([low, high]) => BigInt.asUintN(64, low) + (high << 64n));
      view().setBigInt64(at, BigInt.asIntN(64, x * y), true);
      view().setBigInt64(at + 8, BigInt.asIntN(64, (x * y) >> 64n), true);
    },
    fmod: (a, b) => a % b,
    fmodf: (a, b) => a % b,
    numba_attempt_nocopy_reshape: reshaped,
    NRT_Allocate: (size) => allocate(Number(size)),
    NRT_Free() {},
    NRT_MemInfo_alloc_aligned: made,
    NRT_MemInfo_new_varsize_dtor: made,
    NRT_MemInfo_data_fast: (at) => view().getUint32(at + DATA, true),
    NRT_MemInfo_varsize_realloc(at, size) {
      const [from, to] = [view().getUint32(at + DATA, true), allocate(Number(size))];
      new Uint8Array(memory.buffer).copyWithin(to, from, from + Math.min(Number(size), to - from));
      view().setUint32(at + DATA, to, true);
      return to;
    },
  } });

  // Puts what a kernel takes into memory: {args, back}; back() tells what it changed.
  function put(what, x) {
    if (typeof what === "string") {
      return { args: [["i8", "u8"].includes(what) ? whole(x) : Number(x)], back() {} };
    }
    if (what.of) return array(what.of, x);
    const at = allocate(what.size);
    const v = view();
    new Uint8Array(memory.buffer, at, what.size).fill(0);
    for (const [name, offset, code, shape] of what.fields) { // but for gaps, which knobs do not have
      if (name in x) write(v, at + offset, code, shape, x[name]);
    }
    const before = new Uint8Array(memory.buffer).slice(at, at + what.size);
    return { args: [at], back: () => Object.assign(x, changed(what, at, before)) };
  }

  function array(code, x) {
    const { shape, data } = x.shape ? x : { shape: shapeOf(x), data: x.flat(Infinity) };
    const [size] = KINDS[code];
    const count = shape.reduce((a, b) => a * b, 1);
    const at = allocate(count * size);
    const isRaw = ArrayBuffer.isView(data) && data.BYTES_PER_ELEMENT === size;
    const bytesOf = () => new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
    if (isRaw) new Uint8Array(memory.buffer).set(bytesOf(), at);
    else write(view(), at, code, [count], data);
    const strides = shape.map((_, k) => shape.slice(k + 1).reduce((a, b) => a * b, size));
    return {
      args: [0, 0, BigInt(count), BigInt(size), at, ...[...shape, ...strides].map(BigInt)],
      back: () => isRaw && bytesOf().set(new Uint8Array(memory.buffer, at, count * size)),
    };
  }

  // The fields whose bytes are no longer those `before`; rows that stayed are the same objects.
  function changed({ fields }, at, before) {
    const [v, now] = [view(), new Uint8Array(memory.buffer, at, before.length)];
    return Object.fromEntries(fields.filter(([, offset, code, shape]) => {
      const end = offset + shape.reduce((a, b) => a * b, KINDS[code][0]);
      for (let k = offset; k < end; k++) if (now[k] !== before[k]) return true;
      return false;
    }).map(([name, offset, code, shape]) => [name, read(v, at + offset, code, shape)]));
  }

  function call(name, { takes, returns }, given) {
    heap = top;
    const out = returns ? allocate(returns.size) : 0;
    const error = allocate(8);
    const passed = takes.map((what, k) => put(what, given[k]));
    if (instance.exports[name](out, error, ...passed.flatMap(({ args }) => args))) {
      const said = new Uint8Array(memory.buffer, view().getUint32(error, true));
      throw new Error(new TextDecoder().decode(said.slice(0, said.indexOf(0))));
    }
    for (const { back } of passed) back();
    const parts = returns?.fields.map(([, at, code]) => read(view(), out + at, code, []));
    return returns?.fields[0]?.[0] === "value" ? parts[0] : parts;
  }

  return Object.fromEntries(Object.entries(about).map(([name, how]) =>
    [name, (...given) => call(name, how, given)]));
}

const shapeOf = (rows) => (Array.isArray(rows) ? [rows.length, ...shapeOf(rows[0] ?? 0)] : []);

function write(v, at, code, [count, ...rest], x) {
  const [size, set] = KINDS[code];
  if (count === undefined) return set(v, at, x);
  const wide = rest.reduce((a, b) => a * b, size);
  for (let k = 0; k < count; k++) {
    if (rest.length) write(v, at + k * wide, code, rest, x[k]); else set(v, at + k * wide, x[k]);
  }
}

function read(v, at, code, [count, ...rest]) {
  const [size, , get] = KINDS[code];
  if (count === undefined) return get(v, at);
  const wide = rest.reduce((a, b) => a * b, size);
  return Array.from({ length: count }, (_, k) => read(v, at + k * wide, code, rest));
}

// `kernel` writes the steps to a cell into an array; as rows of rows.
export const stepsOf = (kernel) => (open, x, y) => {
  const [shape, width] = [shapeOf(open), open[0].length];
  const data = new Int32Array(shape[0] * width);
  kernel(open, x, y, { shape, data });
  return open.map((_, row) => Array.from(data.subarray(row * width, (row + 1) * width)));
};
