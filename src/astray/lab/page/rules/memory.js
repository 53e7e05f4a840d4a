// Kernels in WebAssembly, which `astray.lab.wasm` compiles, as functions of JavaScript.
//
// States are objects of numbers, booleans and nested arrays; 64-bit integers are BigInt above 2 ** 53.
// Further arrays are {shape, data} with a typed array, or nested arrays that no kernel changes.

const PAGE = 65536; // bytes
const STACK = 16 * PAGE;
const MADE = 32; // bytes in front of an array that a kernel makes: numba's MemInfo
const DATA = 16; // in which the array's address is here

const whole = (x) => BigInt(typeof x === "number" ? Math.trunc(x) : x);
const exact = (x) => (Number.isSafeInteger(Number(x)) ? Number(x) : x);
const same = (x) => x;
const kind = (array, put = Number, take = same) => {
  const name = array.name.replace("Array", "");
  return { array, put, take, set: DataView.prototype[`set${name}`], get: DataView.prototype[`get${name}`] };
};
// By NumPy's code of a type: arrays of it, and how one number is put there and taken.
const KINDS = {
  b1: kind(Uint8Array, Number, Boolean), f4: kind(Float32Array), f8: kind(Float64Array),
  i1: kind(Int8Array), i2: kind(Int16Array), i4: kind(Int32Array), i8: kind(BigInt64Array, whole, exact),
  u1: kind(Uint8Array), u2: kind(Uint16Array), u4: kind(Uint32Array), u8: kind(BigUint64Array, whole, exact),
};
const product = (axes) => axes.reduce((a, b) => a * b, 1);
const bytesIn = (text) => Uint8Array.from(atob(text), (char) => char.charCodeAt(0)); // of base64
const bytesOf = (array) => new Uint8Array(array.buffer, array.byteOffset, array.byteLength);

// Functions of the names in `about`, which says what they take and return; text: base64.
export async function kernels(text, about) {
  const bytes = bytesIn(text);
  const memory = new WebAssembly.Memory({ initial: 1 + (2 * STACK) / PAGE });
  const top = memory.buffer.byteLength - PAGE; // of the stack, which grows towards what is constant
  const stack = new WebAssembly.Global({ value: "i32", mutable: true }, top);
  let heap = top;
  const view = () => new DataView(memory.buffer);

  function allocate(size) {
    const at = heap;
    heap = 16 * Math.ceil((at + size) / 16); // beyond 4 GiB, `grow` says so
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
    __indirect_function_table: new WebAssembly.Table({ initial: 1024, element: "anyfunc" }),
    __stack_pointer: stack,
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
    if (typeof what === "string") return { args: [KINDS[what].put(x)], back() {} };
    if (what.of) return array(what.of, x);
    const at = allocate(what.size);
    const before = new Uint8Array(what.size);
    const numbers = new DataView(before.buffer);
    for (const [name, offset, code, shape] of what.fields) {
      if (!(name in x)) continue; // a gap, which knobs do not have
      if (shape.length) before.set(bytesOf(packed(code, shape, x[name])), offset);
      else KINDS[code].set.call(numbers, offset, KINDS[code].put(x[name]), true);
    }
    new Uint8Array(memory.buffer).set(before, at);
    return { args: [at], back: () => takeChanged(x, what, at, before) };
  }

  function array(code, x) {
    const { shape, data } = x.shape ? x : { shape: shapeOf(x), data: packed(code, shapeOf(x), x) };
    const at = allocate(data.byteLength);
    new Uint8Array(memory.buffer).set(bytesOf(data), at);
    const strides = shape.map((_, k) => data.BYTES_PER_ELEMENT * product(shape.slice(k + 1)));
    const [count, size] = [product(shape), data.BYTES_PER_ELEMENT].map(BigInt);
    return {
      args: [0, 0, count, size, at, ...[...shape, ...strides].map(BigInt)],
      back: () => x.shape && bytesOf(data).set(new Uint8Array(memory.buffer, at, data.byteLength)),
    };
  }

  // Only fields whose bytes are no longer those `before`: rows that stayed are the same objects.
  function takeChanged(x, { fields }, at, before) {
    const now = new Uint8Array(memory.buffer, at, before.length);
    for (const [name, offset, code, shape] of fields) {
      const end = offset + product(shape) * KINDS[code].array.BYTES_PER_ELEMENT;
      let k = offset;
      while (k < end && now[k] === before[k]) k++;
      if (k < end) x[name] = unpacked(memory.buffer, at + offset, code, shape);
    }
  }

  function call(name, { takes, returns }, given) {
    heap = stack.value = top; // also after what the browser ended
    const out = returns ? allocate(returns.size) : 0;
    const error = allocate(8);
    const passed = takes.map((what, k) => put(what, given[k]));
    if (instance.exports[name](out, error, ...passed.flatMap(({ args }) => args))) {
      const said = new Uint8Array(memory.buffer, view().getUint32(error, true));
      throw new Error(new TextDecoder().decode(said.slice(0, said.indexOf(0))));
    }
    for (const { back } of passed) back();
    const parts = returns?.fields.map(([, at, code]) => unpacked(memory.buffer, out + at, code, []));
    return returns?.fields[0]?.[0] === "value" ? parts[0] : parts;
  }

  return Object.fromEntries(Object.entries(about).map(([name, how]) =>
    [name, (...given) => call(name, how, given)]));
}

const shapeOf = (rows) => (Array.isArray(rows) ? [rows.length, ...shapeOf(rows[0] ?? 0)] : []);

// Nested arrays as a flat one.
function packed(code, shape, x) {
  const { array, put } = KINDS[code];
  const [made, wide] = [new array(product(shape)), shape.at(-1)];
  const rows = shape.length > 1 ? x.flat(shape.length - 2) : [x];
  rows.forEach((row, k) => made.set(put === Number ? row : row.map(put), k * wide));
  return made;
}

function unpacked(buffer, at, code, shape) {
  const { array, take, get } = KINDS[code];
  if (!shape.length) return take(get.call(new DataView(buffer), at, true));
  const flat = new array(buffer.slice(at, at + product(shape) * array.BYTES_PER_ELEMENT));
  let rows = take === same ? Array.from(flat) : Array.from(flat, take);
  for (const wide of shape.slice(1).reverse()) {
    const parts = rows;
    rows = Array.from({ length: rows.length / wide }, (_, k) => parts.slice(k * wide, (k + 1) * wide));
  }
  return rows;
}

// A field of a state in a file: NumPy's code of its type, and its bytes.
export const fieldOf = ([code, text], shape) => unpacked(bytesIn(text).buffer, 0, code, shape);

// `kernel` writes the steps to a cell into an array; returned as nested arrays.
export const stepsOf = (kernel) => (open, x, y) => {
  const shape = shapeOf(open);
  const data = new Int32Array(product(shape));
  kernel(open, x, y, { shape, data });
  return unpacked(data.buffer, 0, "i4", shape);
};
