// A small agent's network, read from its safetensors file and computed here.

const FLOATS = "F32";

export class Network {
  constructor(tensors, architecture) {
    const { shape, largest, actions, width } = architecture;
    this.shape = shape;
    this.actions = actions;
    this.flags = largest.filter((top) => top === 1).length;
    this.circle = circleOf(Math.max(...largest));
    const inputs = tensors["features.linear1.weight"].length / width;
    this.first = transposed(tensors["features.linear1.weight"], width, inputs);
    this.firstBias = tensors["features.linear1.bias"];
    this.second = tensors["features.linear2.weight"];
    this.secondBias = tensors["features.linear2.bias"];
    this.policy = tensors["policy.weight"];
    this.policyBias = tensors["policy.bias"];
    this.value = tensors["value.weight"];
    this.valueBias = tensors["value.bias"];
    this.width = width;
  }

  // Logits [actions] and the value, of planes [C, H, W] with small integers in them.
  outputs({ shape, data }) {
    if (shape.join() !== this.shape.join()) {
      throw new Error(
        `the agent sees observations of shape (${this.shape.join(", ")}), not (${shape.join(", ")})`,
      );
    }
    const hidden = this.#hidden(shape, data);
    return {
      logits: linear(this.policy, this.policyBias, hidden, this.actions),
      value: linear(this.value, this.valueBias, hidden, 1)[0],
    };
  }

  // The last layer but the heads. Most inputs are 0, so the first layer adds columns of the others.
  #hidden([planes, height, columns], data) {
    const { width, first, flags } = this;
    const [cells, many] = [height * columns, planes - flags];
    const sum = Float64Array.from(this.firstBias);
    const add = (input, amount) => {
      for (let k = 0, at = input * width; k < width; k++) sum[k] += amount * first[at + k];
    };
    for (let k = 0; k < data.length; k++) {
      if (!data[k]) continue;
      if (k < flags * cells) {
        add(k, data[k]);
      } else {
        add(k, this.circle[0][data[k]]);
        add(k + many * cells, this.circle[1][data[k]]);
      }
    }
    for (let k = 0; k < width; k++) sum[k] = Math.max(sum[k], 0);
    return linear(this.second, this.secondBias, sum, width).map((x) => Math.max(x, 0));
  }
}

function circleOf(largest) {
  const angles = Array.from({ length: 256 }, (_, k) => k * Math.fround((2 * Math.PI) / largest));
  const cosines = angles.map((angle) => Math.fround(Math.cos(angle)));
  const sines = angles.map((angle) => Math.fround(Math.sin(angle)));
  cosines[0] = sines[0] = 0;
  return [cosines, sines];
}

function transposed(weight, rows, columns) {
  const turned = new Float32Array(weight.length);
  for (let r = 0; r < rows; r++) {
    for (let c = 0; c < columns; c++) turned[c * rows + r] = weight[r * columns + c];
  }
  return turned;
}

function linear(weight, bias, x, outputs) {
  const y = new Float64Array(outputs);
  for (let r = 0, at = 0; r < outputs; r++, at += x.length) {
    let sum = bias[r];
    for (let c = 0; c < x.length; c++) sum += weight[at + c] * x[c];
    y[r] = sum;
  }
  return y;
}

// The network in a safetensors file that astray wrote, an ArrayBuffer.
export function readNetwork(buffer) {
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const { architecture } = JSON.parse(header.__metadata__.astray);
  if (!["mlp", "small"].includes(architecture.name)) { // older files say small
    throw new Error(`network '${architecture.name}' is not computed without Python`);
  }
  const tensors = {};
  for (const [name, { dtype, data_offsets: offsets }] of Object.entries(header)) {
    if (dtype !== FLOATS) continue;
    const [from, to] = offsets;
    tensors[name] = new Float32Array(buffer.slice(8 + length + from, 8 + length + to));
  }
  return new Network(tensors, architecture);
}

export function softmax(logits) {
  const most = Math.max(...logits);
  const powers = Array.from(logits, (x) => Math.exp(x - most));
  const sum = powers.reduce((a, b) => a + b, 0);
  return powers.map((x) => x / sum);
}
