"use strict";
(() => {
  // What a picture of a panel cannot do by itself: tips, points that lead to trials, a legend that
  // hides, and zoom. Places across and down the axes are shares from 0 to 1.
  const SIDE = 1000; // of what is stretched over the axes, as in svg_renderer.py
  const NEAR = 24; // a tip is of the nearest point within this distance [px]
  const BESIDE = 12; // between a point and its tip [px]
  const DRAGGED = 6; // from which a drag is one [px]
  const MOST_TICKS = 6;
  const LONGEST = 10000; // of an animation [ms]; shorter responses are shown as fast as they were
  const KEYS = "Arrow keys go from point to point, Enter opens a trial";
  const number = (value) => String(Number(value.toPrecision(4)));

  // An axis: values of places, and round numbers between two places.
  class Axis {
    constructor(text) {
      const [low, high, scale, named] = text.split(" ");
      this.log = scale === "log";
      this.named = Boolean(named);
      [this.low, this.high] = [low, high].map((end) => (this.log ? Math.log10(end) : Number(end)));
    }
    value(place) {
      const value = this.low + place * (this.high - this.low);
      return this.log ? 10 ** value : value;
    }
    place(value) {
      return ((this.log ? Math.log10(value) : value) - this.low) / (this.high - this.low);
    }
    ticks(from, to) {
      const [low, high] = [this.value(from), this.value(to)];
      const rough = (high - low) / MOST_TICKS;
      const power = 10 ** Math.floor(Math.log10(rough));
      const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough * (1 - 1e-9));
      const found = [];
      for (let k = Math.ceil(low / step); k * step <= high; k += 1) found.push(k * step);
      return found.map((value) => [this.place(value), String(Number(value.toPrecision(6)))]);
    }
  }

  class Plot {
    constructor(element, texts) {
      this.element = element;
      this.texts = texts;
      this.axes = element.querySelector(".axes");
      this.x = new Axis(this.axes.dataset.x);
      this.y = new Axis(this.axes.dataset.y);
      this.labels = this.axes.dataset.labels.split("\n");
      const place = (mark, name) => parseFloat(mark.getAttribute(name)) / 100;
      this.marks = [...this.axes.querySelectorAll("use")].map((mark) => ({
        mark, x: place(mark, "x"), y: place(mark, "y"),
        group: mark.closest("[data-name]"), told: mark.dataset.tip !== undefined,
        trial: mark.dataset.trial,
      }));
      this.told = this.marks.filter(({ told }) => told).sort((a, b) => a.x - b.x);
      this.view = [0, 1, 0, 1];
      this.tip = document.createElement("div");
      this.tip.className = "tip";
      this.tip.setAttribute("role", "status");
      this.tip.hidden = true;
      element.append(this.tip);
      if (this.told.length) {
        element.tabIndex = 0;
        element.setAttribute("role", "group");
        element.setAttribute("aria-label", KEYS);
        element.addEventListener("keydown", (event) => this.step(event));
        element.addEventListener("blur", () => this.hide());
      }
      element.addEventListener("pointermove", (event) => this.over(event));
      element.addEventListener("pointerleave", () => this.hide());
      element.addEventListener("click", (event) => this.click(event));
      element.addEventListener("pointerdown", (event) => this.drag(event));
      element.addEventListener("dblclick", () => this.zoom([0, 1, 0, 1]));
    }

    // Where the axes are [px], and what the pointer is at.
    get box() { return this.axes.getBoundingClientRect(); }
    at({ clientX, clientY }) {
      const { left, top, width, height } = this.box;
      return [(clientX - left) / width, (clientY - top) / height];
    }
    get isOfTime() { return this.labels[0].startsWith("time") && !this.x.log && !this.x.named; }
    get measured() { return [...this.axes.querySelectorAll(".traced:not([stroke-dasharray])")]; }
    inView({ x, y }) {
      const [a, b, c, d] = this.view;
      return [(x - a) / (b - a), (y - c) / (d - c)];
    }

    over(event) {
      if (this.from) return this.stretch(event);
      const { width, height } = this.box;
      const [across, down] = this.at(event);
      const distance = (point) => {
        const [x, y] = this.inView(point);
        return Math.hypot((x - across) * width, (y - down) * height);
      };
      const shown = ({ group }) => !group.hasAttribute("hidden");
      let best = null;
      let least = NEAR;
      for (const point of [...this.marks.filter(shown), ...this.onLines()]) {
        const away = distance(point) - (point.told ? 4 : 0);
        if (away < least) [best, least] = [point, away];
      }
      const found = best || this.onField(across, down);
      if (found) this.show(found);
      else this.hide();
    }

    // The points of lines that have no texts of their own.
    onLines() {
      this.lines = this.lines || [...this.axes.querySelectorAll(".traced")].map((path) => ({
        group: path.closest("[data-name]"),
        points: path.getAttribute("d").match(/[-\d.]+,[-\d.]+/g)?.map((pair) => pair.split(",").map((v) => v / SIDE)) || [],
      }));
      return this.lines.filter(({ group }) => !group.hasAttribute("hidden"))
        .flatMap(({ group, points }) => points.map(([x, y]) => ({ x, y, group })));
    }

    // The value of a field at a place.
    onField(across, down) {
      const image = this.axes.querySelector("image");
      const [a, b, c, d] = this.view;
      const [x, y] = [a + across * (b - a), c + down * (d - c)];
      if (!image || x < 0 || x > 1 || y < 0 || y > 1) return null;
      const [columns, rows] = image.dataset.places.split(";").map((list) => list.split(",").map((v) => v / SIDE));
      const nearest = (places, at) => places.reduce((best, place, k) => (Math.abs(place - at) < Math.abs(places[best] - at) ? k : best), 0);
      const [j, i] = [nearest(columns, x), nearest(rows, y)];
      const value = image.dataset.values.split(";")[i].split(",")[j];
      return value === "" ? null : { x: columns[j], y: rows[i], value };
    }

    words({ mark, x, y, group, value, told }) {
      if (told) return this.texts[mark.dataset.tip] + (mark.dataset.trial ? "\n(click to open)" : "");
      const of = (label, axis, place) => `${label} ${number(axis.value(place))}`.trim();
      const lines = [of(this.labels[0], this.x, x), of(this.labels[1], this.y, 1 - y)];
      if (value !== undefined) lines.push(value);
      else if (group.dataset.name) lines.unshift(group.dataset.name);
      return lines.join("\n");
    }

    // It stays within the axes, on the side of the point where there is more room.
    show(point) {
      this.shown = point;
      this.tip.textContent = this.words(point);
      this.tip.hidden = false;
      this.element.classList.toggle("leads", Boolean(point.trial));
      const outer = this.element.getBoundingClientRect();
      const { left, top, width, height } = this.box;
      const [l, t] = [left - outer.left, top - outer.top];
      this.tip.style.maxWidth = `${width}px`;
      this.tip.style.maxHeight = `${height}px`;
      const [across, down] = this.inView(point);
      const [x, y] = [l + across * width, t + down * height];
      const beside = across > 0.5 ? x - BESIDE - this.tip.offsetWidth : x + BESIDE;
      const within = (place, low, high) => Math.max(low, Math.min(place, high));
      this.tip.style.left = `${within(beside, l, l + width - this.tip.offsetWidth)}px`;
      this.tip.style.top = `${within(y - this.tip.offsetHeight / 2, t, t + height - this.tip.offsetHeight)}px`;
    }
    hide() {
      this.shown = null;
      this.tip.hidden = true;
      this.element.classList.remove("leads");
    }

    step(event) {
      const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (event.key === "Enter") this.open();
      else if (event.key === "Escape") this.hide();
      if (!by) return;
      event.preventDefault();
      const seen = this.told.filter((point) => !point.group.hasAttribute("hidden") && this.inView(point).every((v) => v >= 0 && v <= 1));
      const next = seen.indexOf(this.shown) + by;
      if (seen.length) this.show(seen[(next + seen.length) % seen.length]);
    }

    // A finger has no place to hover: its first touch shows the tip, and the second one opens.
    click(event) {
      const before = this.touched;
      this.touched = this.shown;
      if (this.dragged || (event.pointerType === "touch" && before !== this.shown)) return;
      this.open();
    }
    open() {
      if (!this.shown?.trial) return;
      this.element.dispatchEvent(new CustomEvent("trial", { bubbles: true, detail: Number(this.shown.trial) }));
    }

    drag(event) {
      this.dragged = false;
      if (event.pointerType !== "mouse" || event.button !== 0) return;
      event.preventDefault();
      this.from = this.at(event);
      this.area = document.createElement("div");
      this.area.className = "dragged";
      const stop = (last) => {
        removeEventListener("pointerup", stop);
        const [from, to] = [this.from, this.at(last)];
        this.from = null;
        this.area.remove();
        if (this.dragged) this.zoom(this.between(from, to));
      };
      addEventListener("pointerup", stop);
    }
    stretch(event) {
      const { left, top, width, height } = this.box;
      const outer = this.element.getBoundingClientRect();
      const [[a, c], [b, d]] = [this.from, this.at(event)];
      if (Math.hypot((b - a) * width, (d - c) * height) > DRAGGED) this.dragged = true;
      if (!this.dragged) return;
      this.hide();
      this.element.append(this.area);
      Object.assign(this.area.style, {
        left: `${left - outer.left + Math.min(a, b) * width}px`, width: `${Math.abs(b - a) * width}px`,
        top: `${top - outer.top + Math.min(c, d) * height}px`, height: `${Math.abs(d - c) * height}px`,
      });
    }

    // The view between two corners; a drag along one axis leaves the other as it is.
    between([a, c], [b, d]) {
      const { width, height } = this.box;
      const [x0, x1, y0, y1] = this.view;
      const along = (axis, low, high, p, q, size) => {
        if (axis.named || Math.abs(p - q) * size < 3 * DRAGGED) return [low, high];
        return [Math.min(p, q), Math.max(p, q)].map((v) => low + Math.max(0, Math.min(1, v)) * (high - low));
      };
      return [...along(this.x, x0, x1, a, b, width), ...along(this.y, y0, y1, c, d, height)];
    }

    zoom(view) {
      const ticks = this.axes.querySelector(".ticks");
      this.ticks = this.ticks || ticks.innerHTML;
      this.view = view;
      const [a, b, c, d] = view;
      const whole = view.every((v, k) => v === [0, 1, 0, 1][k]);
      for (const part of this.axes.querySelectorAll(".stretched")) {
        part.setAttribute("viewBox", `${a * SIDE} ${c * SIDE} ${(b - a) * SIDE} ${(d - c) * SIDE}`);
      }
      for (const point of this.marks) {
        const [x, y] = this.inView(point);
        point.mark.setAttribute("x", `${100 * x}%`);
        point.mark.setAttribute("y", `${100 * y}%`);
        point.mark.style.display = x < 0 || x > 1 || y < 0 || y > 1 ? "none" : "";
      }
      if (whole) ticks.innerHTML = this.ticks;
      else {
        const percent = (v, low, high) => `${(100 * (v - low)) / (high - low)}%`;
        const line = 'stroke="var(--gray)" stroke-opacity=".3"';
        ticks.innerHTML = [
          ...this.x.ticks(a, b).map(([at, text]) => [percent(at, a, b), text]).map(([x, text]) =>
            `<line x1="${x}" x2="${x}" y2="100%" ${line}/><text x="${x}" y="100%" dy="15" text-anchor="middle">${text}</text>`),
          ...this.y.ticks(1 - d, 1 - c).map(([at, text]) => [percent(1 - at, c, d), text]).map(([y, text]) =>
            `<line y1="${y}" x2="100%" y2="${y}" ${line}/><text x="-5" y="${y}" dy="4" text-anchor="end">${text}</text>`),
        ].join("");
      }
      this.hide();
    }
  }

  // Lets what was measured, the lines without dashes, come up as time goes on.
  class Animation {
    constructor(plots, button) {
      this.plots = plots;
      this.button = button;
      button.addEventListener("click", () => (this.frame ? this.stop() : this.start()));
    }
    start() {
      this.cursors = this.plots.map(({ element }) => {
        const cursor = document.createElement("div");
        cursor.className = "cursor";
        element.append(cursor);
        return cursor;
      });
      const seconds = Math.max(...this.plots.map(({ x }) => x.value(1) - x.value(0)));
      this.duration = Math.min(1000 * seconds, LONGEST);
      this.begin = performance.now();
      this.button.textContent = "Stop";
      this.show();
    }
    show() {
      const share = (performance.now() - this.begin) / this.duration;
      if (share >= 1) return this.stop();
      this.plots.forEach((plot, k) => {
        const [from, to] = plot.view;
        const at = Math.max(0, Math.min(1, (share - from) / (to - from)));
        for (const line of plot.measured) {
          const { x, width: length } = line.getBBox();
          const seen = (share * SIDE - x) / length;
          line.style.clipPath = `inset(-${SIDE}px ${100 * (1 - seen)}% -${SIDE}px 0) fill-box`;
        }
        const { left, top, width, height } = plot.box;
        const outer = plot.element.getBoundingClientRect();
        Object.assign(this.cursors[k].style, {
          left: `${left - outer.left + at * width}px`, top: `${top - outer.top}px`, height: `${height}px`,
        });
      });
      this.frame = requestAnimationFrame(() => this.show());
    }
    stop() {
      cancelAnimationFrame(this.frame);
      this.frame = 0;
      this.button.textContent = "Play";
      this.cursors.forEach((cursor) => cursor.remove());
      for (const plot of this.plots) plot.measured.forEach((line) => { line.style.clipPath = ""; });
    }
  }

  function play(figure, plots) {
    const ofTime = plots.filter((plot) => plot.isOfTime && plot.measured.length);
    if (!ofTime.length) return;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "play small";
    button.textContent = "Play";
    button.setAttribute("aria-label", "Play as it went");
    figure.querySelector("h3, h4").after(button);
    new Animation(ofTime, button);
  }

  function adopt(figure) {
    const texts = JSON.parse(figure.querySelector("script").textContent);
    const plots = [...figure.querySelectorAll(".plot")].map((element) => new Plot(element, texts));
    play(figure, plots);
    // What can be reached by the keyboard is no picture any more.
    if (plots.some(({ told }) => told.length)) figure.querySelector(".panels").setAttribute("role", "group");
    for (const button of figure.querySelectorAll(".legend button")) {
      button.addEventListener("click", () => {
        const show = button.getAttribute("aria-pressed") === "false";
        button.setAttribute("aria-pressed", String(show));
        for (const part of figure.querySelectorAll("[data-name]")) {
          if (part.dataset.name === button.dataset.name && part !== button) part.toggleAttribute("hidden", !show);
        }
      });
    }
  }
  const all = (root) => root.querySelectorAll("figure").forEach(adopt);
  all(document);
  document.addEventListener("replaced", (event) => all(event.target));
})();
