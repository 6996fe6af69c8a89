// The player: loads an episode on demand, plays it, and keeps slider, scene, charts and words in step.

class Player {
  constructor(root, index, order) {
    Object.assign(this, { root, index, order, time: 0, playing: false, follow: false, streets: new Map() });
    const part = (name) => root.querySelector(`[data-part=${name}]`);
    for (const name of ["play", "slider", "clock", "speed", "title", "verdict", "facts", "words", "contact", "canvas",
      "previous", "next", "follow", "natural", "reference", "plans", "names", "fit", "mark", "command", "margin", "badge"]) this[name + "Part"] = part(name);
    this.scene = new Scene(this.canvasPart);
    this.charts = new Charts(part("charts"), (time) => this.seek(time));
    this.listen();
  }

  listen() {
    const click = (name, act) => this[name + "Part"].addEventListener("click", () => { if (this.episode) act(); });
    click("play", () => this.toggle());
    click("previous", () => this.step(-1));
    click("next", () => this.step(1));
    click("contact", () => this.seek(this.facts.moment));
    click("fit", () => { this.setFollow(false); this.scene.fit(); this.draw(); });
    click("follow", () => this.setFollow(!this.follow));
    click("natural", () => this.flip("natural"));
    click("reference", () => this.flip("reference"));
    click("plans", () => this.flip("plans"));
    click("names", () => this.flip("names"));
    this.sliderPart.addEventListener("input", () => this.seek(Number(this.sliderPart.value)));
    this.root.addEventListener("keydown", (event) => this.key(event));
    document.addEventListener("keydown", (event) => {
      if (event.target === document.body && this.inSight()) this.key(event);
    });
    new ResizeObserver(() => this.resize()).observe(this.root);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    this.listenToCanvas();
  }

  listenToCanvas() {
    const canvas = this.canvasPart, held = new Map();
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls on
      event.preventDefault();
      if (!this.episode) return;
      this.scene.zoom(Math.exp(-0.002 * event.deltaY), event.offsetX, event.offsetY);
      this.draw();
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      held.set(event.pointerId, [event.clientX, event.clientY]);
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = held.get(event.pointerId);
      if (!last || !this.episode) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      this.setFollow(false);
      this.scene.pan(event.clientX - last[0], event.clientY - last[1]);
      this.draw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
  }

  inSight() {
    const { top, bottom } = this.root.getBoundingClientRect();
    return bottom > 0 && top < innerHeight;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.episode) return;
    const tag = event.target.tagName, ownKeys = tag === "SELECT" || tag === "TEXTAREA" || (tag === "INPUT" && event.target.type !== "range");
    if (ownKeys || (tag === "BUTTON" && (event.key === " " || event.key === "Enter"))) return;
    const tick = event.shiftKey ? 1 : this.episode.dt, acts = {
      " ": () => this.toggle(), k: () => this.toggle(),
      ArrowRight: () => this.seek(this.time + tick), ArrowLeft: () => this.seek(this.time - tick),
      Home: () => this.seek(0), End: () => this.seek(this.episode.end),
      c: () => this.seek(this.facts.moment), f: () => this.setFollow(!this.follow), g: () => this.flip("natural"), r: () => this.flip("reference"), t: () => this.flip("plans"), l: () => this.flip("names"),
      n: () => this.step(1), p: () => this.step(-1), 0: () => { this.setFollow(false); this.scene.fit(); this.draw(); },
      "+": () => { this.scene.zoom(1.25); this.draw(); }, "-": () => { this.scene.zoom(0.8); this.draw(); },
      "]": () => this.hurry(1), "[": () => this.hurry(-1),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  hurry(by) {
    const { options, selectedIndex } = this.speedPart;
    this.speedPart.selectedIndex = Math.max(0, Math.min(selectedIndex + by, options.length - 1));
  }

  flip(what) {
    if (this[what + "Part"].disabled) return;
    this.scene.shown[what] = !this.scene.shown[what];
    this[what + "Part"].setAttribute("aria-pressed", this.scene.shown[what]);
    this.draw();
  }

  setFollow(on) {
    if (on && !this.follow) this.scene.zoom(Math.max(1, 7 / this.scene.view.scale));
    this.follow = on;
    this.followPart.setAttribute("aria-pressed", on);
    this.draw();
  }

  // Opens an episode; `named` puts it into the address.
  async load(number, named = true) {
    const facts = this.index.get(number);
    if (!facts) return;
    this.pause();
    this.root.setAttribute("aria-busy", "true");
    this.wanted = number;
    const [episode, streets] = await Promise.all([readEpisode(`e${number}`), this.streetsOf(facts.net)]);
    if (this.wanted !== number) return; // another one was asked for meanwhile
    this.resize(); // the canvas may not have been measured yet
    Object.assign(this, { number, facts, episode, follow: false });
    this.followPart.setAttribute("aria-pressed", "false");
    this.tell();
    this.scene.show(episode, streets, facts);
    this.charts.show(episode, facts);
    this.charts.resize();
    this.seek(facts.moment);
    this.root.removeAttribute("aria-busy");
    this.root.dataset.episode = number;
    if (named) history.replaceState(null, "", `#play-${number}`);
    for (const row of document.querySelectorAll("#episodes tr[aria-current]")) row.removeAttribute("aria-current");
    document.getElementById(`row-${number}`)?.setAttribute("aria-current", "true");
  }

  streetsOf(net) {
    if (net < 0) return [];
    if (!this.streets.has(net)) this.streets.set(net, readStreets(`net-${net}`));
    return this.streets.get(net);
  }

  tell() {
    const { facts, episode } = this;
    this.titlePart.textContent = facts.title;
    this.verdictPart.textContent = facts.verdict;
    this.badgePart.textContent = facts.badge;
    this.badgePart.className = `badge ${facts.badge.replaceAll(" ", "-")}`;
    this.verdictPart.className = `verdict ${facts.fault}`;
    this.factsPart.textContent = facts.line;
    this.commandPart.textContent = facts.command;
    this.commandPart.parentElement.hidden = !facts.command;
    this.marginPart.textContent = facts.margin;
    this.marginPart.parentElement.hidden = !facts.margin;
    this.contactPart.textContent = facts.momentName;
    this.sliderPart.max = episode.end;
    this.sliderPart.step = episode.dt;
    this.markPart.hidden = facts.contact === null;
    this.markPart.style.setProperty("--share", facts.contact === null ? 0 : facts.contact / Math.max(episode.end, 1e-6));
    for (const what of ["natural", "reference", "plans"]) {
      this[what + "Part"].disabled = !episode[what];
      this[what + "Part"].setAttribute("aria-pressed", Boolean(episode[what]) && this.scene.shown[what]);
    }
    this.canvasPart.setAttribute("aria-label", `Map of ${facts.title}: streets, and ${episode.agents.length} road users as boxes that move with time`);
  }

  step(by) {
    const numbers = this.order(), at = numbers.indexOf(this.number);
    const number = at < 0 ? numbers[0] : numbers[at + by];
    if (number !== undefined) this.load(number);
  }

  toggle() {
    if (!this.episode) return;
    if (this.playing) { this.pause(); return; }
    if (this.time >= this.episode.end - 1e-6) this.time = 0;
    this.playing = true;
    this.playPart.textContent = "❚❚";
    this.playPart.setAttribute("aria-label", "Pause");
    this.last = performance.now();
    requestAnimationFrame((now) => this.frame(now));
  }

  pause() {
    this.playing = false;
    this.playPart.textContent = "▶";
    this.playPart.setAttribute("aria-label", "Play");
    if (this.episode) this.say();
  }

  frame(now) {
    if (!this.playing) return;
    this.time += Math.min((now - this.last) / 1000, 0.25) * Number(this.speedPart.value);
    this.last = now;
    if (this.time >= this.episode.end) { this.time = this.episode.end; this.pause(); }
    this.draw();
    if (this.playing) requestAnimationFrame((next) => this.frame(next));
  }

  seek(time) {
    if (!this.episode) return;
    this.time = Math.max(0, Math.min(time, this.episode.end));
    this.draw();
    if (!this.playing) this.say();
  }

  say() {
    this.wordsPart.textContent = this.charts.words(this.time);
  }

  draw() {
    if (!this.episode || !this.scene.width) return;
    if (this.follow) this.scene.centre(this.time / this.episode.dt);
    this.scene.draw(this.time);
    this.charts.at(this.time);
    this.sliderPart.value = this.time;
    this.sliderPart.setAttribute("aria-valuetext", `${this.time.toFixed(1)} of ${this.episode.end.toFixed(1)} seconds`);
    this.clockPart.textContent = `${this.time.toFixed(1)} / ${this.episode.end.toFixed(1)} s`;
    this.verdictPart.toggleAttribute("data-now", this.facts.contact !== null && this.time >= this.facts.contact - 1e-6);
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvasPart;
    if (!clientWidth || (clientWidth === this.scene.width && clientHeight === this.scene.height)) return;
    const before = this.scene.width;
    this.scene.resize(clientWidth, clientHeight);
    if (!this.episode) return;
    if (before) this.scene.zoom(clientWidth / before);
    this.charts.resize();
    this.draw();
  }

  recolour() {
    this.scene.colours();
    if (!this.episode) return;
    this.charts.show(this.episode, this.facts);
    this.charts.resize();
    this.draw();
  }
}
