// Charts over time under the scene, by uPlot; a line through all of them stands at the player's time.

const CHARTS = [
  { key: "speed_mps", rival: "attacker_mps", careful: "reference_mps", title: "Speed", unit: "m/s", low: 0, high: 1 },
  { key: "accel_mps2", rival: "attacker_accel_mps2", careful: "reference_accel_mps2", title: "Acceleration", unit: "m/s²", low: -1, high: 1 },
  { key: "jerk_mps3", title: "Jerk", unit: "m/s³", low: -1, high: 1 },
  { key: "ttc_s", title: "Time to collision", unit: "s", low: 0, high: 10 },
  { key: "gap_m", title: "Gap to the nearest", unit: "m", low: 0, high: 1 },
];

const asText = (value) => (value === null || value === undefined ? "–" : value.toFixed(1).replace(/^-0\.0$/, "0.0").replace("-", "−"));

class Charts {
  constructor(place, seek) {
    Object.assign(this, { place, seek, plots: [] });
  }

  show(episode, facts) {
    for (const { plot } of this.plots) plot.destroy();
    this.place.replaceChildren();
    this.episode = episode;
    this.facts = facts;
    const times = Array.from({ length: episode.steps }, (_, k) => k * episode.dt);
    this.plots = times.length > 1 ? CHARTS.map((chart) => this.make(chart, times)) : [];
    if (!this.plots.length) this.place.textContent = "It ended at its first instant: there is nothing to chart.";
  }

  make(chart, times) {
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    const name = document.createElement("b"), value = document.createElement("span"), body = document.createElement("div");
    name.textContent = `${chart.title} (${chart.unit}) `;
    caption.append(name, value);
    body.setAttribute("role", "img");
    body.setAttribute("aria-label", this.facts.charts[chart.title] ?? chart.title);
    figure.append(caption, body);
    this.place.append(figure);
    const style = getComputedStyle(document.documentElement), colour = (role) => style.getPropertyValue(`--${role}`).trim();
    const axis = { stroke: colour("muted"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const range = (_, least, most) => uPlot.rangeNum(Math.min(chart.low, least ?? chart.low), Math.max(chart.high, most ?? chart.high), 0.05, false);
    const keys = [chart.rival, chart.careful, chart.key].filter((key) => key && this.episode.charts[key].some((v) => v !== null));
    const plot = new uPlot({
      width: this.width(), height: 112, legend: { show: false }, padding: [6, 8, 0, 0],
      cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
      scales: { x: { time: false }, y: { range } },
      axes: [{ ...axis, size: 22, space: 40 }, { ...axis, size: 40, space: 24 }],
      series: [{}, ...keys.map((key) => ({
        stroke: colour({ [chart.rival]: "attacker", [chart.careful]: "reference" }[key] ?? "target"), width: 1.8, points: { show: false },
        dash: { [chart.rival]: [5, 3], [chart.careful]: [2, 2] }[key],
      }))],
      hooks: { draw: [(u) => this.markContact(u, colour("impact"))] },
    }, [times, ...keys.map((key) => this.episode.charts[key])], body);
    const now = document.createElement("div");
    now.className = "now";
    plot.over.append(now);
    plot.over.addEventListener("pointerdown", (event) => this.seek(plot.posToVal(event.offsetX, "x")));
    return { chart, plot, now, value };
  }

  markContact(plot, colour) {
    if (this.facts.contact === null) return;
    const x = plot.valToPos(this.facts.contact, "x", true), { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = colour;
    ctx.lineWidth = 1.5 * devicePixelRatio;
    ctx.setLineDash([5, 4]);
    ctx.beginPath();
    ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }

  width() {
    return Math.max(140, Math.floor(this.place.firstElementChild?.clientWidth ?? 300));
  }

  resize() {
    for (const { plot } of this.plots) plot.setSize({ width: this.width(), height: 112 });
    if (this.time !== undefined) this.at(this.time);
  }

  at(time) {
    this.time = time;
    const k = Math.max(0, Math.min(Math.round(time / this.episode.dt), this.episode.steps - 1));
    for (const { chart, now, value } of this.plots) {
      now.style.left = `${(100 * time) / Math.max(this.episode.end, 1e-6)}%`;
      const own = asText(this.episode.charts[chart.key][k]), rival = chart.rival && this.episode.charts[chart.rival][k];
      const careful = chart.careful && this.episode.charts[chart.careful][k], given = (one) => one !== null && one !== undefined;
      const named = [given(rival) && `${this.facts.hit ? "collision partner" : "nearest"} ${asText(rival)}`, given(careful) && `careful driver ${asText(careful)}`].filter(Boolean);
      value.textContent = named.length ? [`target ${own}`, ...named].join(", ") : own;
    }
  }

  // Returns the instant in words, for those who listen.
  words(time) {
    const k = Math.max(0, Math.min(Math.round(time / this.episode.dt), this.episode.steps - 1)), { charts } = this.episode;
    const parts = [`${time.toFixed(1)} seconds`, `target ${asText(charts.speed_mps[k])} metres per second`];
    if (charts.ttc_s[k] !== null) parts.push(`time to collision ${asText(charts.ttc_s[k])} seconds`);
    if (charts.gap_m[k] !== null) parts.push(`gap ${asText(charts.gap_m[k])} metres`);
    if (this.facts.contact !== null && time >= this.facts.contact - 1e-6) parts.push("after the contact");
    return parts.join(", ");
  }
}
