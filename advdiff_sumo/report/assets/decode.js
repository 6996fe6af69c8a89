// Turns the page's blocks back into numbers; the layout is that of advdiff_sumo/report/encode.py.

const PER_M = 100, PER_RAD = 500, PER_UNIT = 100, NOTHING = -32768;

async function inflate(id) {
  const text = document.getElementById(id).textContent.trim();
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

class Block {
  static async read(id) {
    return new Block(await inflate(id));
  }

  constructor(bytes) {
    const length = new DataView(bytes.buffer, bytes.byteOffset).getUint32(0, true);
    this.header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const codes = bytes.subarray(4 + length);
    this.low = codes.subarray(0, codes.length / 2);
    this.high = codes.subarray(codes.length / 2);
    this.at = 0;
  }

  next() {
    const code = this.low[this.at] | (this.high[this.at++] << 8);
    return code & 1 ? -((code + 1) / 2) : code / 2;
  }

  // Returns `count` values whose second differences come next.
  smooth(first, count, scale) {
    const values = new Float64Array(count);
    let value = first, step = 0;
    values[0] = value / scale;
    for (let k = 1; k < count; k++) values[k] = (value += step += this.next()) / scale;
    return values;
  }

  // Returns `count` values whose differences modulo 2^16 come next; null where there is none.
  series(count) {
    const values = new Array(count);
    let value = 0;
    for (let k = 0; k < count; k++) {
      value = ((value + this.next()) << 16) >> 16;
      values[k] = value === NOTHING ? null : value / PER_UNIT;
    }
    return values;
  }

  // Returns the parts of one agent's path: instants, positions relative to the block's origin, headings.
  parts(heads) {
    return heads.map(([start, count, x, y, yaw]) => ({
      start, count,
      x: this.smooth(x, count, PER_M), y: this.smooth(y, count, PER_M), yaw: this.smooth(yaw, count, PER_RAD),
    }));
  }
}

async function readEpisode(id) {
  const block = await Block.read(id), { header } = block;
  for (const agent of header.agents) agent.parts = block.parts(agent.p);
  for (const agent of header.natural?.agents ?? []) {
    agent.parts = block.parts(agent.p);
    agent.row = header.agents.findIndex((other) => other.id === agent.id);
  }
  for (const agent of header.reference?.agents ?? []) agent.parts = block.parts(agent.p);
  readPlans(block);
  const charts = {};
  for (const name of header.series) charts[name] = block.series(header.steps);
  return { ...header, charts, end: header.dt * (header.steps - 1) };
}

// Gives each agent its plans, in the order of time; see advdiff_sumo/report/plans.py.
function readPlans(block) {
  const { plans, agents } = block.header;
  for (const { r, n, x, y } of plans?.series ?? []) {
    const own = agents[r].plans = agents[r].plans || [];
    let made = 0, left = x, down = y;
    for (let k = 0; k < n; k++) {
      made += block.next();
      const first = block.next(), count = block.next();
      left += block.next(); down += block.next();
      const xs = block.smooth(left, count, PER_M), ys = block.smooth(down, count, PER_M);
      own.push({ made: made * plans.dt, first, x: xs, y: ys });
    }
  }
}

async function readStreets(id) {
  const block = await Block.read(id), { cells, size } = block.header;
  return cells.map(({ at, lines }) => {
    const [area, solid, dashed] = lines.map((counts, kind) => {
      const path = new Path2D();
      for (const count of counts) {
        let x = 0, y = 0;
        for (let k = 0; k < count; k++) {
          x += block.next(); y += block.next();
          if (k) path.lineTo(x / PER_M, y / PER_M); else path.moveTo(x / PER_M, y / PER_M);
        }
        if (kind === 0) path.closePath();
      }
      return path;
    });
    return { x: at[0], y: at[1], size, area, solid, dashed };
  });
}

// Returns where an agent is at a time given in instants, between two of them in proportion; null when it is absent.
function poseAt(parts, instant) {
  for (const part of parts) {
    const k = instant - part.start;
    if (k < -1e-6 || k > part.count - 1 + 1e-6) continue;
    const i = Math.max(0, Math.min(Math.floor(k + 1e-6), part.count - 1)), j = Math.min(i + 1, part.count - 1);
    const share = Math.max(0, Math.min(k - i, 1)), mix = (values) => values[i] + share * (values[j] - values[i]);
    return { x: mix(part.x), y: mix(part.y), yaw: mix(part.yaw) };
  }
  return null;
}
