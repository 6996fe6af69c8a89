// Draws one instant of an episode on a canvas; world coordinates are metres, east and north.

const HISTORY_S = 2;

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.ground = document.createElement("canvas");
    this.shown = { natural: true, reference: true, plans: true, names: false };
    this.view = { x: 0, y: 0, scale: 4 };
    this.labels = {}; // of target and attacker, by row, in pixels: where their names stand
    this.colours();
  }

  colours() {
    const style = getComputedStyle(document.documentElement), names = ["ground", "area", "marking", "target", "attacker",
      "other", "moved", "impact", "text", "page", "muted", "natural", "reference"];
    this.colour = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    this.drawn = "";
  }

  show(episode, streets, facts) {
    Object.assign(this, { episode, streets, facts, drawn: "" });
    this.special = new Set([episode.target, episode.attacker]);
    this.fit();
  }

  resize(width, height) {
    const ratio = devicePixelRatio || 1;
    Object.assign(this, { width, height, ratio, drawn: "" });
    for (const canvas of [this.canvas, this.ground]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
  }

  // Shows the target's whole way, and the attacker's where it is near, with room for their names at the sides.
  fit() {
    const { episode, facts } = this, [ox, oy] = episode.origin, points = [];
    for (let k = 0; k < episode.steps; k++) {
      const target = poseAt(episode.agents[episode.target].parts, k);
      if (!target) continue;
      points.push([target.x, target.y]);
      const attacker = episode.attacker >= 0 && poseAt(episode.agents[episode.attacker].parts, k);
      if (attacker && Math.hypot(attacker.x - target.x, attacker.y - target.y) < 50) points.push([attacker.x, attacker.y]);
    }
    if (facts.impact) points.push([facts.impact[0] - ox, facts.impact[1] - oy]);
    const bounds = (axis) => [Math.min(...points.map((p) => p[axis])), Math.max(...points.map((p) => p[axis]))];
    const [x0, x1] = bounds(0), [y0, y1] = bounds(1), margin = 24;
    const across = this.width - 2 * Math.min(120, 0.16 * this.width);
    const scale = Math.min(across / Math.max(x1 - x0, 35), this.height / Math.max(y1 - y0 + margin, 35));
    this.view = { x: ox + (x0 + x1) / 2, y: oy + (y0 + y1) / 2, scale };
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const { view } = this, scale = Math.max(0.2, Math.min(view.scale * factor, 80));
    const dx = px - this.width / 2, dy = py - this.height / 2;
    view.x += dx / view.scale - dx / scale;
    view.y -= dy / view.scale - dy / scale;
    view.scale = scale;
  }

  pan(dx, dy) {
    this.view.x -= dx / this.view.scale;
    this.view.y += dy / this.view.scale;
  }

  centre(instant) {
    const pose = poseAt(this.episode.agents[this.episode.target].parts, instant);
    if (pose) Object.assign(this.view, { x: this.episode.origin[0] + pose.x, y: this.episode.origin[1] + pose.y });
  }

  // Makes `pen` draw metres relative to (x, y) of the net.
  world(pen, x, y) {
    const { view, ratio } = this, k = view.scale * ratio;
    pen.setTransform(k, 0, 0, -k, ratio * this.width / 2 + k * (x - view.x), ratio * this.height / 2 - k * (y - view.y));
  }

  draw(time) {
    const { pen, episode } = this, [ox, oy] = episode.origin, instant = time / episode.dt;
    this.drawGround();
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.drawImage(this.ground, 0, 0);
    this.world(pen, ox, oy);
    pen.lineJoin = pen.lineCap = "round";
    if (this.shown.natural && episode.natural) this.drawNatural(time);
    if (this.shown.reference && episode.reference) this.drawReference(time);
    this.drawPaths(instant);
    if (this.shown.plans && episode.plans) this.drawPlans(time);
    const rows = [...episode.agents.keys()].filter((row) => !this.special.has(row));
    for (const row of [...rows, episode.attacker, episode.target]) if (row >= 0) this.drawAgent(row, instant);
    this.drawImpacts(time);
    this.drawLabels(instant);
    this.drawScale();
  }

  drawGround() {
    const { view, colour } = this, key = [view.x, view.y, view.scale, this.width, this.height].join();
    if (key === this.drawn) return;
    this.drawn = key;
    const pen = this.ground.getContext("2d"), px = 1 / view.scale;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = colour.ground;
    pen.fillRect(0, 0, this.ground.width, this.ground.height);
    const reachX = this.width / 2 / view.scale, reachY = this.height / 2 / view.scale;
    const cells = this.streets.filter((cell) => cell.x < view.x + reachX && cell.x + cell.size > view.x - reachX
      && cell.y < view.y + reachY && cell.y + cell.size > view.y - reachY);
    for (const cell of cells) {
      this.world(pen, cell.x, cell.y);
      pen.fillStyle = pen.strokeStyle = colour.area;
      pen.lineWidth = px;
      pen.fill(cell.area, "evenodd");
      pen.stroke(cell.area); // hides the seams between cells
    }
    if (view.scale < 1) return;
    for (const cell of cells) {
      this.world(pen, cell.x, cell.y);
      pen.strokeStyle = colour.marking;
      pen.lineWidth = Math.max(px, 0.14);
      pen.setLineDash([]);
      pen.stroke(cell.solid);
      pen.setLineDash([3, 3]);
      pen.stroke(cell.dashed);
      pen.setLineDash([]);
    }
  }

  role(row) {
    const { episode, colour } = this;
    if (row === episode.target) return colour.target;
    if (row === episode.attacker) return colour.attacker;
    return episode.agents[row].m ? colour.moved : colour.other;
  }

  trace(parts, from, to) {
    const { pen } = this;
    pen.beginPath();
    for (const part of parts) {
      const first = Math.max(from, part.start), last = Math.min(to, part.start + part.count - 1);
      if (last - first < 1e-6) continue;
      const begin = poseAt([part], first), end = poseAt([part], last);
      pen.moveTo(begin.x, begin.y);
      for (let k = Math.ceil(first); k <= Math.floor(last); k++) pen.lineTo(part.x[k - part.start], part.y[k - part.start]);
      pen.lineTo(end.x, end.y);
    }
    pen.stroke();
  }

  // The last two seconds of everybody; of target and attacker all that was driven, and dotted what is to come.
  drawPaths(instant) {
    const { pen, episode, view } = this, px = 1 / view.scale, past = instant - HISTORY_S / episode.dt;
    episode.agents.forEach((agent, row) => {
      pen.strokeStyle = this.role(row);
      if (this.special.has(row)) {
        pen.globalAlpha = 0.45;
        pen.lineWidth = 1.5 * px;
        this.trace(agent.parts, 0, past);
        pen.setLineDash([px, 5 * px]);
        pen.lineWidth = 2 * px;
        this.trace(agent.parts, instant, Infinity);
        pen.setLineDash([]);
      }
      pen.globalAlpha = this.special.has(row) ? 0.9 : 0.5;
      pen.lineWidth = (this.special.has(row) ? 3 : 2) * px;
      this.trace(agent.parts, past, instant);
    });
    pen.globalAlpha = 1;
  }

  // What target and vehicles near it mean to do now; of target and attacker with a circle at every step of the plan.
  drawPlans(time) {
    const { pen, episode, colour, view } = this, { every } = episode.plans, px = 1 / view.scale;
    episode.agents.forEach(({ plans, parts }, row) => {
      const plan = plans?.filter((one) => one.made <= time + 1e-6).pop();
      if (!plan || time > plan.made + every + 1e-6) return;
      const known = this.special.has(row), start = plan.first === 1 && poseAt(parts, plan.made / episode.dt);
      pen.strokeStyle = this.role(row);
      pen.globalAlpha = known ? 1 : 0.7;
      pen.lineWidth = (known ? 2 : 1.2) * px;
      pen.beginPath();
      if (start) pen.moveTo(start.x, start.y);
      plan.x.forEach((x, k) => pen.lineTo(x, plan.y[k]));
      pen.stroke();
      if (!known) return;
      pen.fillStyle = colour.page;
      plan.x.forEach((x, k) => {
        pen.beginPath();
        pen.arc(x, plan.y[k], 3.2 * px, 0, 2 * Math.PI);
        pen.fill();
        pen.stroke();
      });
    });
    pen.globalAlpha = 1;
  }

  drawNatural(time) {
    const { pen, episode, colour, view } = this, { natural } = episode, px = 1 / view.scale;
    pen.strokeStyle = colour.natural;
    for (const ghost of natural.agents) {
      pen.lineWidth = (this.special.has(ghost.row) ? 4 : 2) * px;
      pen.globalAlpha = 0.55;
      this.trace(ghost.parts, 0, Infinity);
      const pose = poseAt(ghost.parts, (time - natural.t0) / natural.dt), size = episode.agents[ghost.row]?.s;
      if (!pose || !size) continue;
      pen.globalAlpha = 1;
      pen.lineWidth = 1.5 * px;
      pen.setLineDash([3 * px, 2 * px]);
      this.box(pose, size);
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.globalAlpha = 1;
  }

  // The careful driver beside the target, from its takeover on; where it stands at the end it stays.
  drawReference(time) {
    const { pen, episode, colour, view } = this, { reference } = episode, px = 1 / view.scale, [{ parts }] = reference.agents;
    const now = (time - reference.t0) / reference.dt, last = parts[parts.length - 1], end = last.start + last.count - 1;
    pen.strokeStyle = pen.fillStyle = colour.reference;
    pen.lineWidth = 4 * px;
    pen.globalAlpha = 0.55;
    this.trace(parts, 0, Infinity);
    const pose = now >= -1e-6 && poseAt(parts, Math.min(now, end));
    if (pose) {
      this.box(pose, episode.agents[episode.target].s);
      pen.globalAlpha = 0.3;
      pen.fill();
      pen.globalAlpha = 1;
      pen.lineWidth = 2 * px;
      pen.setLineDash([5 * px, 3 * px]);
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.globalAlpha = 1;
  }

  box({ x, y, yaw }, [length, width]) {
    const { pen } = this, c = Math.cos(yaw), s = Math.sin(yaw), a = length / 2, b = width / 2;
    pen.beginPath();
    for (const [u, v] of [[a, b], [-a, b], [-a, -b], [a, -b]]) pen.lineTo(x + u * c - v * s, y + u * s + v * c);
    pen.closePath();
  }

  drawAgent(row, instant) {
    const { pen, episode, view, colour } = this, agent = episode.agents[row], pose = poseAt(agent.parts, instant);
    if (!pose) return;
    const px = 1 / view.scale, [length, width] = agent.s, c = Math.cos(pose.yaw), s = Math.sin(pose.yaw);
    const at = (u, v) => [pose.x + u * c - v * s, pose.y + u * s + v * c];
    pen.fillStyle = this.role(row);
    pen.strokeStyle = colour.page;
    pen.lineWidth = px;
    this.box(pose, agent.s);
    pen.fill();
    pen.stroke();
    pen.beginPath(); // an arrow head that points to the front
    pen.moveTo(...at(length * 0.42, 0));
    pen.lineTo(...at(length * 0.12, width * 0.36));
    pen.lineTo(...at(length * 0.12, -width * 0.36));
    pen.closePath();
    pen.fillStyle = colour.page;
    pen.fill();
  }

  drawImpacts(time) {
    const { pen, facts, view, colour, episode } = this, [ox, oy] = episode.origin;
    const cross = (x, y, half, width) => {
      pen.lineWidth = width / view.scale;
      const r = half / view.scale;
      pen.beginPath();
      pen.moveTo(x - r, y - r); pen.lineTo(x + r, y + r);
      pen.moveTo(x - r, y + r); pen.lineTo(x + r, y - r);
      pen.stroke();
    };
    pen.strokeStyle = colour.impact;
    for (const [x, y, when] of facts.others) if (time >= when - 1e-6) cross(x - ox, y - oy, 5, 2);
    if (!facts.impact) return;
    const [x, y] = [facts.impact[0] - ox, facts.impact[1] - oy];
    if (time < facts.contact - 1e-6) return;
    cross(x, y, 8, 4);
    pen.beginPath();
    pen.lineWidth = 2 / view.scale;
    pen.arc(x, y, 18 / view.scale, 0, 2 * Math.PI);
    pen.stroke();
  }

  // Names stand in pixels, so that they do not turn with the world; those of target and attacker on the sides away from each other.
  drawLabels(instant) {
    const { pen, episode, view, ratio, colour } = this, [ox, oy] = episode.origin;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.font = "600 12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineWidth = 3;
    episode.agents.forEach((agent, row) => {
      if (!this.special.has(row) && !this.shown.names) return;
      const pose = poseAt(agent.parts, instant);
      if (!pose) return;
      const known = row === episode.target ? "target" : this.facts.hit ? "collision partner" : "nearest";
      const text = this.shown.names ? agent.id : known, [east, north] = this.labelSide(row, pose, instant);
      const apart = this.reach(pose, agent.s, east, north) * view.scale + 4
        + 0.5 * Math.abs(east) * pen.measureText(text).width + 7 * Math.abs(north);
      const x = this.width / 2 + (ox + pose.x - view.x) * view.scale + apart * east;
      const y = this.height / 2 - (oy + pose.y - view.y) * view.scale - apart * north;
      pen.strokeStyle = colour.ground;
      pen.fillStyle = this.role(row);
      pen.strokeText(text, x, y);
      pen.fillText(text, x, y);
      if (this.special.has(row)) this.labels[row] = [x, y];
    });
  }

  // Returns the unit vector (east, north) from a box to its name: target and attacker away from each other, others up.
  labelSide(row, pose, instant) {
    const { target, attacker, agents } = this.episode;
    const rival = row === target ? attacker : row === attacker ? target : -1, other = rival >= 0 && poseAt(agents[rival].parts, instant);
    if (!other) return [0, row === target ? -1 : 1];
    const dx = pose.x - other.x, dy = pose.y - other.y, apart = Math.hypot(dx, dy);
    return apart < 1e-6 ? [0, row === target ? -1 : 1] : [dx / apart, dy / apart];
  }

  // Returns how far in metres a box extends from its centre along a unit vector.
  reach({ yaw }, [length, width], east, north) {
    const c = Math.cos(yaw), s = Math.sin(yaw);
    return 0.5 * (length * Math.abs(c * east + s * north) + width * Math.abs(c * north - s * east));
  }

  drawScale() {
    const { pen, view, colour } = this, metres = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((m) => m * view.scale >= 60) ?? 1000;
    const x = 12, y = this.height - 12;
    pen.strokeStyle = pen.fillStyle = colour.muted;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, y - 4); pen.lineTo(x, y); pen.lineTo(x + metres * view.scale, y); pen.lineTo(x + metres * view.scale, y - 4);
    pen.stroke();
    pen.textAlign = "left";
    pen.font = "12px system-ui, sans-serif";
    pen.fillText(`${metres} m`, x + 4, y - 8);
  }
}
